//! Colours of terminal text, and the escaping of text from other sources.
//!
//! A style is two marks in a text, and [`rendered`] replaces them with the terminal's own sequences. It also
//! escapes every character that would move the cursor, change colours or turn the direction of reading: names and
//! descriptions come from files, and lines from programs, and neither may overwrite the output of this program.
//! `anstream` removes the colours where the output is no terminal or NO_COLOR is set.

use anstyle::{AnsiColor, Style};

/// Marks of the styles: noncharacters of Unicode, which are reserved for internal use and occur in no exchanged
/// text.
const GOOD: char = '\u{fdd0}';
const BAD: char = '\u{fdd1}';
const STRONG: char = '\u{fdd2}';
const DIM: char = '\u{fdd3}';
const END: char = '\u{fdd4}';

fn marked(style: char, text: &str) -> String {
    format!("{style}{text}{END}")
}

/// The text styled as correct.
pub(crate) fn good(text: &str) -> String {
    marked(GOOD, text)
}

/// The text styled as needing attention.
pub(crate) fn bad(text: &str) -> String {
    marked(BAD, text)
}

/// The text styled as most important.
pub(crate) fn strong(text: &str) -> String {
    marked(STRONG, text)
}

/// The text styled as least important.
pub(crate) fn dim(text: &str) -> String {
    marked(DIM, text)
}

/// The text without its style marks, for a page.
pub(crate) fn plain(text: &str) -> String {
    text.chars().filter(|c| ![GOOD, BAD, STRONG, DIM, END].contains(c)).collect()
}

/// The text with the terminal's sequences for its styles, and with dangerous characters escaped.
pub(crate) fn rendered(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut style = Style::new();
    for c in text.chars() {
        let begun = match c {
            GOOD => AnsiColor::Green.on_default(),
            BAD => AnsiColor::Red.on_default().bold(),
            STRONG => Style::new().bold(),
            DIM => Style::new().dimmed(),
            END => {
                out.push_str(&style.render_reset().to_string());
                continue;
            }
            c if is_dangerous(c) => {
                out.extend(c.escape_default());
                continue;
            }
            c => {
                out.push(c);
                continue;
            }
        };
        style = begun;
        out.push_str(&style.render().to_string());
    }
    out
}

/// Text of other origin, such as the contents of a file: unchanged for a program that reads it, escaped for a
/// terminal.
pub(crate) fn data(text: &str, is_terminal: bool) -> String {
    if is_terminal { rendered(text) } else { text.into() }
}

/// Prints a line on standard error.
pub(crate) fn say(line: &str) {
    anstream::eprintln!("{}", rendered(line));
}

/// Whether a character is dangerous: control characters other than line ends and tabs, and marks that turn
/// the direction of reading.
fn is_dangerous(c: char) -> bool {
    let turns = matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() && c != '\n' && c != '\t' || turns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_says_does_not_reach_the_terminal_as_a_command() {
        let name = "roll\u{1b}[2J\u{1b}]0;x\u{7}\r\u{9b}31m\u{202e}";
        assert_eq!(rendered(name), r"roll\u{1b}[2J\u{1b}]0;x\u{7}\r\u{9b}31m\u{202e}");
        assert_eq!(rendered("two\n\tlines, µ and °"), "two\n\tlines, µ and °");
        assert_eq!(rendered(&bad(name)), format!("\u{1b}[1m\u{1b}[31m{}\u{1b}[0m", rendered(name)));
        assert_eq!(data(name, false), name);
    }
}
