//! The bench in a terminal: the same frames as on the page, drawn with characters.

mod board;
mod draw;

use std::io;
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::TryRecvError;

use crate::hub::{Hub, Sent};
use board::Board;

/// Time between two redraws.
const PICTURE: Duration = Duration::from_millis(100);

/// A terminal that shows the frames of a hub. When this is dropped, the terminal is restored.
pub struct Terminal {
    terminal: DefaultTerminal,
    frames: Receiver<Sent>,
    board: Board,
    due: Instant,
}

impl Terminal {
    /// Takes over the terminal.
    ///
    /// # Errors
    /// When there is no terminal.
    pub fn open(hub: &Hub) -> io::Result<Self> {
        if !io::IsTerminal::is_terminal(&io::stdout()) {
            return Err(io::Error::other("standard output is not a terminal"));
        }
        let (told, frames, _) = hub.join();
        let mut board = Board::default();
        told.iter().for_each(|text| board.take(text));
        Ok(Self { terminal: ratatui::try_init()?, frames, board, due: Instant::now() })
    }

    /// Shows the received frames, and waits for a key until a time. Returns whether the user wants to leave.
    ///
    /// # Errors
    /// When the terminal is gone.
    pub fn turn(&mut self, until: Instant) -> io::Result<bool> {
        loop {
            match self.frames.try_recv() {
                Ok(Sent::Frame(text)) => self.board.take(&text),
                Err(TryRecvError::Lagged(_)) => {}
                Ok(Sent::End) | Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        let now = Instant::now();
        if now >= self.due {
            self.due = now + PICTURE;
            let board = &self.board;
            self.terminal.draw(|frame| draw::draw(frame, board))?;
        }
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if !event::poll(left)? {
                return Ok(false);
            }
            if let Event::Key(key) = event::read()? {
                let interrupt =
                    key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
                if interrupt || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) {
                    return Ok(true);
                }
            }
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        ratatui::restore();
    }
}
