//! The generator against closed forms and the simulator; trials from draw to score.

mod closed_loop;
mod generators;
mod motion;
mod random;
mod trials;
