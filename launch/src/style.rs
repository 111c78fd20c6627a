//! Colour, which `anstream` leaves out where no terminal is or NO_COLOR is set.

use anstyle::{AnsiColor, Style};

fn painted(style: Style, text: &str) -> String {
    format!("{style}{text}{style:#}")
}

/// For what is as it should be.
pub(crate) fn good(text: &str) -> String {
    painted(AnsiColor::Green.on_default(), text)
}

/// For what needs attention.
pub(crate) fn bad(text: &str) -> String {
    painted(AnsiColor::Red.on_default().bold(), text)
}

/// For what matters most.
pub(crate) fn strong(text: &str) -> String {
    painted(Style::new().bold(), text)
}

/// For what matters least.
pub(crate) fn dim(text: &str) -> String {
    painted(Style::new().dimmed(), text)
}
