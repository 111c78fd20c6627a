//! Tests of the generator against closed forms and the simulator, and of trials from draw to score.

mod closed_loop;
mod generators;
mod motion;
mod random;
mod trials;
