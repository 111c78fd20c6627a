use super::*;
use proptest::prelude::*;

const GOOD: Conditions = Conditions {
    arm: true,
    arm_is_known: true,
    link: true,
    data_age: Some(Duration::from_millis(5)),
    data_interval: Some(Duration::from_millis(10)),
    vehicle_well: true,
    outputs: true,
    commands: true,
    finite: true,
    estimate: true,
    signs: true,
    pilot: None,
};
const PILOT: PilotView = PilotView { present: true, neutral: true, automatic: true };
const STALE: Duration = Duration::from_millis(250);

fn arming(arm: ArmBy) -> Arming {
    Arming::new(Policy { arm, stale: STALE, recover_after: None })
}

fn at(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Every possible failure of the conditions, with the expected reason.
fn breaks() -> [(Conditions, Reason); 8] {
    [
        (Conditions { link: false, ..GOOD }, Reason::LinkDown),
        (Conditions { data_age: None, ..GOOD }, Reason::Stale),
        (Conditions { data_age: Some(at(251)), ..GOOD }, Reason::Stale),
        (Conditions { vehicle_well: false, ..GOOD }, Reason::VehicleFailsafe),
        (Conditions { outputs: false, ..GOOD }, Reason::OutputDown),
        (Conditions { finite: false, ..GOOD }, Reason::NotFinite),
        (Conditions { commands: false, ..GOOD }, Reason::NoCommand),
        (Conditions { estimate: false, ..GOOD }, Reason::Diverged),
    ]
}

#[test]
fn whatever_breaks_keeps_from_arming_and_ends_it_with_its_reason() {
    for (broken, reason) in breaks() {
        for arm in [ArmBy::Start, ArmBy::Autopilot] {
            let mut a = arming(arm);
            assert_eq!(a.update(&broken, at(0)), None, "{reason}");
            assert_eq!((a.mode(), a.refused()), (Mode::Disarmed, Some(reason)));
            assert_eq!(a.update(&GOOD, at(1)), Some(Mode::Automatic));
            assert_eq!(a.update(&broken, at(2)), Some(Mode::Failed(reason)));
            assert_eq!(a.update(&GOOD, at(60_000)), None, "it does not come back by itself");
        }
    }
}

#[test]
fn an_attitude_that_comes_too_rarely_to_lose_one_keeps_from_arming_and_ends_no_flight() {
    let mut a = arming(ArmBy::Start);
    let every = |ms| Conditions { data_interval: Some(at(ms)), ..GOOD };
    assert_eq!(a.update(&every(126), at(0)), None);
    assert_eq!((a.mode(), a.refused()), (Mode::Disarmed, Some(Reason::TooRare)));
    assert_eq!(a.update(&every(125), at(1)), Some(Mode::Automatic));
    assert_eq!(a.update(&every(126), at(2)), None, "what is lost in flight is told by its age");
}

#[test]
fn a_switch_must_be_moved_while_everything_is_well() {
    let mut a = arming(ArmBy::Switch);
    let off = Conditions { arm: false, ..GOOD };
    a.update(&GOOD, at(0));
    assert_eq!(a.mode(), Mode::Disarmed, "it was on from the beginning");
    a.update(&off, at(1));
    a.update(&Conditions { link: false, ..GOOD }, at(2));
    a.update(&GOOD, at(3));
    assert_eq!(a.mode(), Mode::Disarmed, "it was moved too early");
    a.update(&off, at(4));
    assert_eq!(a.update(&GOOD, at(5)), Some(Mode::Automatic));
    assert_eq!(a.update(&off, at(6)), Some(Mode::Disarmed));
}

#[test]
fn arming_needs_a_stick_in_the_middle_and_flying_does_not() {
    let mut a = arming(ArmBy::Start);
    let with = |pilot| Conditions { pilot: Some(pilot), ..GOOD };
    a.update(&with(PilotView { neutral: false, ..PILOT }), at(0));
    assert_eq!((a.mode(), a.refused()), (Mode::Disarmed, Some(Reason::StickNotNeutral)));
    assert_eq!(a.update(&with(PILOT), at(1)), Some(Mode::Automatic));
    assert_eq!(a.update(&with(PilotView { neutral: false, ..PILOT }), at(2)), None);
}

#[test]
fn the_pilots_switch_always_wins() {
    let manual = PilotView { automatic: false, ..PILOT };
    for (broken, reason) in breaks() {
        let mut a = arming(ArmBy::Start);
        let with = |c: Conditions, pilot| Conditions { pilot: Some(pilot), ..c };
        a.update(&with(GOOD, PILOT), at(0));
        assert_eq!(a.update(&with(GOOD, manual), at(1)), Some(Mode::Manual));
        assert_eq!(a.update(&with(broken, manual), at(2)), None, "the pilot flies on: {reason}");
        assert_eq!(a.update(&with(broken, PILOT), at(3)), Some(Mode::Failed(reason)));
        assert_eq!(a.update(&with(broken, manual), at(4)), Some(Mode::Manual));
        assert_eq!(a.update(&with(GOOD, PILOT), at(5)), Some(Mode::Automatic));
        let gone = PilotView { present: false, ..manual };
        assert_eq!(a.update(&with(GOOD, gone), at(6)), Some(Mode::Failed(Reason::PilotLost)));
    }
}

#[test]
fn a_pilot_who_is_lost_after_the_vehicle_is_told_too() {
    let mut a = arming(ArmBy::Start);
    let well = Conditions { pilot: Some(PILOT), ..GOOD };
    a.update(&well, at(0));
    assert_eq!(a.mode(), Mode::Automatic);
    let stale = Conditions { data_age: None, ..well };
    assert_eq!(a.update(&stale, at(10)), Some(Mode::Failed(Reason::Stale)));
    let alone = Conditions { pilot: Some(PilotView { present: false, ..PILOT }), ..stale };
    assert_eq!(a.update(&alone, at(20)), Some(Mode::Failed(Reason::PilotLost)));
}

#[test]
fn a_bench_without_a_pilot_may_come_back_when_it_was_told_to() {
    let policy = Policy { arm: ArmBy::Start, stale: STALE, recover_after: Some(at(1000)) };
    let mut a = Arming::new(policy);
    let broken = Conditions { link: false, ..GOOD };
    a.update(&GOOD, at(0));
    a.update(&broken, at(10));
    a.update(&GOOD, at(20));
    a.update(&broken, at(900));
    a.update(&GOOD, at(1000));
    assert_eq!(a.update(&GOOD, at(1999)), None);
    assert_eq!(a.update(&GOOD, at(2000)), Some(Mode::Automatic));
    assert_eq!(a.restarted(), Some(Mode::Failed(Reason::Restarted)));
}

prop_compose! {
    fn conditions()(
        bits in prop::array::uniform8(prop::bool::weighted(0.9)),
        age in prop::option::weighted(0.95, 0u64..300),
        pilot in prop::option::of((prop::bool::weighted(0.9), any::<bool>(), any::<bool>())),
    ) -> Conditions {
        let [arm, link, vehicle_well, outputs, commands, finite, estimate, signs] = bits;
        let pilot = pilot.map(|(present, neutral, automatic)| PilotView { present, neutral, automatic });
        Conditions { arm, arm_is_known: true, link, data_age: age.map(at), data_interval: None, vehicle_well, outputs, commands, finite, estimate, signs, pilot }
    }
}

proptest! {
    #[test]
    fn the_controller_is_in_charge_only_while_all_is_well(
        sequence in prop::collection::vec(conditions(), 1..100),
        arm in prop::sample::select(vec![ArmBy::Switch, ArmBy::Autopilot, ArmBy::Start]),
    ) {
        let mut a = arming(arm);
        for (i, c) in sequence.iter().enumerate() {
            a.update(c, at(i as u64 * 5));
            if a.mode() == Mode::Automatic {
                prop_assert!(c.link && c.vehicle_well && c.outputs && c.commands && c.finite && c.estimate && c.signs);
                prop_assert!(c.data_age.is_some_and(|age| age <= STALE));
                prop_assert!(c.arm || arm == ArmBy::Start);
                prop_assert!(c.pilot.is_none_or(|p| p.present && p.automatic));
            }
            if a.mode() == Mode::Manual {
                prop_assert!(c.pilot.is_some_and(|p| p.present && !p.automatic));
            }
        }
    }
}

#[test]
fn a_bridge_that_was_started_again_waits_for_a_new_arm() {
    let off = Conditions { arm: false, ..GOOD };
    for by in [ArmBy::Autopilot, ArmBy::Switch] {
        let mut a = arming(by);
        assert_eq!(a.come_back(), Mode::Failed(Reason::BridgeRestarted));
        let silent = Conditions { arm: false, arm_is_known: false, link: false, data_age: None, ..GOOD };
        assert_eq!(a.update(&silent, at(0)), None, "nothing was received yet, which is no disarm");
        assert_eq!(a.update(&GOOD, at(0)), None, "what was armed before it died");
        assert_eq!(a.update(&GOOD, at(60_000)), None);
        assert_eq!(a.update(&off, at(60_001)), Some(Mode::Disarmed));
        assert_eq!(a.update(&GOOD, at(60_002)), Some(Mode::Automatic));
    }
    // The pilot's radio is heard last of all, with its arm switch on.
    let mut a = arming(ArmBy::Switch);
    a.come_back();
    let absent = Some(PilotView { present: false, ..PILOT });
    let silent = Conditions { arm: false, arm_is_known: false, pilot: absent, ..GOOD };
    assert_eq!(a.update(&silent, at(0)), Some(Mode::Failed(Reason::PilotLost)));
    assert_eq!(a.update(&silent, at(1)), None, "no disarm either");
    let heard = Conditions { pilot: Some(PILOT), ..GOOD };
    assert_eq!(a.update(&heard, at(2)), None, "what was armed before it died");
    assert_eq!(a.update(&Conditions { arm: false, ..heard }, at(3)), Some(Mode::Disarmed));
    assert_eq!(a.update(&heard, at(4)), Some(Mode::Automatic));
    let mut start = arming(ArmBy::Start);
    start.come_back();
    assert_eq!(start.update(&GOOD, at(60_000)), None);
}

#[test]
fn the_document_numbers_the_reasons_as_the_log_does() {
    let document = include_str!("../../../docs/bridges.md");
    for reason in Reason::ALL {
        let row = format!("| {} | {reason} |", reason.number());
        assert!(document.contains(&row), "docs/bridges.md lacks: {row}");
    }
    assert_eq!(Reason::ALL.map(Reason::number), std::array::from_fn(|i| i as u32 + 1));
}
