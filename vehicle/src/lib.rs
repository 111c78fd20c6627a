//! What is simulated: state-space models, effects, sensors and vehicle files.
