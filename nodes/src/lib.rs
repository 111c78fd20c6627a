//! The processes of a bench: plant, estimator, controller, recorder.
