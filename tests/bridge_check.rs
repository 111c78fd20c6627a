//! `whirlstand bridge check` of a vehicle behind MAVLink, which somebody turns by hand: what is wrong is reported, and
//! nothing moves without consent.

use crate::support::mavlink::{autopilot, end, free_port, launch};
use crate::support::{Finished, json, said, spawn_listening, spawn_listening_to_terminal, whirlstand};
use whirlstand_test_harness::{Missing, Outcome, python};

fn the_check_says_which_axis_or_channel_is_turned_and_that_each_channel_arrives() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let file = launch(dir.path(), port, "");
    // On this vehicle's own radio, channel 1 goes down for a roll to the right.
    let wrong = ["--arm-after", "1e9", "--hand", "--turned", "pitch", "--reversed", "roll"];
    let vehicle = autopilot(&python, port, &report, &wrong);
    let file = file.to_str().unwrap();
    let check = whirlstand(["bridge", "check", "plant", "--launch", file, "--timeout", "30", "--yes"]);
    let (vehicle, check) = spawn_listening(vehicle, check);
    let checked = check.finish();
    end(vehicle);
    let said = said(&report);
    assert_eq!(checked.code(), 1, "{said:?}\n{}", checked.stderr);
    for words in [
        ["ok", "roll: +"],
        ["WRONG", "pitch: the sign is turned"],
        ["ok", "yaw: +"],
        ["ok", "channel 1: +100 us"],
        ["ok", "channel 2: +100 us"],
        ["u_roll + -> channel 1 down", "the vehicle rolls left and pitches nose down"],
        [
            "WRONG",
            "channel 1: -300 us for the roll stick to the right, and the bridge has it the other way round",
        ],
        ["ok", "channel 2: +300 us for the pitch stick back"],
    ] {
        assert!(said.iter().any(|l| words.iter().all(|w| l.contains(w))), "{words:?}: {said:#?}");
    }
    Ok(())
}

/// Checks a vehicle that somebody turns by hand, with more options, and on a terminal with these words typed; returns
/// the result, what was said, and how often a channel moved.
fn check_by_hand(options: &[&str], typed: Option<&str>) -> Result<(Finished, Vec<String>, u64), Missing> {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let file = launch(dir.path(), port, "");
    let vehicle = autopilot(&python, port, &report, &["--arm-after", "1e9", "--hand"]);
    let mut check = whirlstand(["bridge", "check", "plant", "--launch", file.to_str().unwrap()]);
    check.args(["--timeout", "30"]).args(options);
    let (vehicle, check) = match typed {
        Some(typed) => spawn_listening_to_terminal(vehicle, check, typed),
        None => spawn_listening(vehicle, check),
    };
    let checked = check.finish();
    end(vehicle);
    let seen = json(&report);
    assert_eq!(seen["faults"], serde_json::json!([]), "{}", checked.stderr);
    Ok((checked, said(&report), seen["moved_before_armed"].as_u64().unwrap()))
}

/// Nothing moves without `--yes` or a yes at the question on a terminal, which names the channels and the propellers.
fn the_check_moves_no_channel_without_consent() -> Outcome {
    for (options, typed, moves, code, words) in [
        (&[][..], None, false, 1, Some("there is no terminal to ask for consent: --yes gives it")),
        (&[], Some("\n"), false, 1, Some("there was no consent to moving it")),
        (&[], Some("no\n"), false, 1, Some("there was no consent to moving it")),
        (&["--no-outputs"], Some("y\n"), false, 0, None),
        (&["--yes"], None, true, 0, None),
        (&[], Some("y\n"), true, 0, None),
    ] {
        let (checked, said, moved) = check_by_hand(options, typed)?;
        let what = format!("{options:?}, {typed:?}: {said:#?}\n{}", checked.stderr);
        assert_eq!((checked.code(), moved > 0), (code, moves), "{what}");
        let unchecked = said.iter().filter(|l| l.starts_with("not checked channel")).count();
        assert_eq!(unchecked, if words.is_some() { 2 } else { 0 }, "{what}");
        assert!(words.is_none_or(|w| said.iter().any(|l| l.contains(w))), "{what}");
        let asked = typed.is_some() && options.is_empty();
        let question = "This check moves channels 1 (roll) and 2 (pitch) of the vehicle by 100 us. Are the propellers off";
        assert_eq!(checked.stderr.contains(question), asked, "{what}");
        for axis in ["ok roll: +", "ok pitch: +", "ok yaw: +"] {
            assert!(said.iter().any(|l| l.starts_with(axis)), "{axis}: {what}");
        }
    }
    Ok(())
}

whirlstand_test_harness::listed!(
    the_check_says_which_axis_or_channel_is_turned_and_that_each_channel_arrives,
    the_check_moves_no_channel_without_consent
);
