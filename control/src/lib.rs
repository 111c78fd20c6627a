//! What steers: Riccati, LQR, pole placement, sliding mode and Kalman filters.
