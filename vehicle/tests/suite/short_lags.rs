//! Nonlinear forces behind short lags.

use whirlstand_vehicle::{Simulator, Vehicle};

/// A lag far shorter than a period is no reason for short steps of the drag behind it, which follows it all the same: as in
/// periods a 64th as long.
#[test]
fn drag_follows_a_force_through_a_short_lag() {
    const PERIOD_S: f64 = 0.01;
    const FINER: usize = 64;
    for time_constant_s in [0.001, 0.0025, 0.02] {
        let text = format!(
            "A = [[0.0]]\nB = [[1.0]]\nstates = [{{ name = \"v\", unit = \"m/s\" }}]\ninputs = [{{ name = \"u\" }}]\n\
             [[effects]]\neffect = \"actuator_lag\"\nwhere = \"u\"\ntime_constant_s = {time_constant_s}\n\
             [[effects]]\neffect = \"quadratic_drag\"\nwhere = \"v\"\ncoefficient = 2.0\n"
        );
        let vehicle = Vehicle::parse(&text, "car.toml").unwrap();
        let mut coarse = Simulator::expected(&vehicle, PERIOD_S).unwrap();
        let mut fine = Simulator::expected(&vehicle, PERIOD_S / FINER as f64).unwrap();
        let mut apart = 0.0f64;
        for k in 0..2000 {
            let u = if k % 80 < 40 { 3.0 } else { -2.0 };
            coarse.step(&[u]);
            (0..FINER).for_each(|_| fine.step(&[u]));
            apart = apart.max((coarse.state()[0] - fine.state()[0]).abs());
        }
        assert!(apart < 2e-5, "{time_constant_s} s: {apart} of about 1 m/s");
    }
}
