//! The generator against closed forms and the simulator; trials from draw to score.

mod motion;
mod random;
mod trials;
