use whirlstand_ident::identify::*;
fn main() {
    let record = whirlstand_logs::read("/tmp/rep/g.csv", &[]).unwrap();
    let vehicle = whirlstand_vehicle::Vehicle::builtin("quadrotor-structure").unwrap();
    let log = Log { file: "g".into(), sha256: "".into() };
    let s = |a, b| Source {
        log: log.clone(),
        segment: Segment::new(&record, &vehicle, None, (Some(a), Some(b))).unwrap(),
    };
    for parts in [vec![s(0.0, 60.0)], vec![s(0.0, 5.8), s(6.6, 60.0)], vec![s(0.0, 5.9), s(6.3, 12.0)]] {
        for noise in [Noise::Kalman, Noise::White] {
            let o = Options { closed_loop: true, noise: Some(noise), ..Options::default() };
            println!("{}", identify(&vehicle, &parts, &[], &o, &|_| ()).unwrap().text());
        }
    }
}
