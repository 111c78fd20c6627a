//! Fuzz test of launch files: any text gives benches that can be started, or an error that names its place.
//!
//! An input is a built-in file whose lines and values were damaged. `cargo test` tries some inputs;
//! `WHIRLSTAND_FUZZ_INPUTS` sets their number and `WHIRLSTAND_FUZZ_SEED` selects them.

use std::panic::catch_unwind;

use whirlstand_nodes::config::NodeConfig;
use whirlstand_vehicle::Stream;

use super::builtin::{BUILTIN, FoundFile};
use super::document::{Document, LaunchError};
use super::jobs::{Jobs, jobs_of};
use crate::cli::OverrideArgs;

/// Values and fragments that are wrong in most places.
const WORDS: [&str; 44] = [
    "nan",
    "inf",
    "-inf",
    "0",
    "-1",
    "1e308",
    "1e-320",
    "0.0",
    "-0.0",
    "9223372036854775807",
    "1e9",
    "true",
    "''",
    "'5 deg'",
    "'5 parsec'",
    "'80 ms'",
    "'-3 s'",
    "[]",
    "[[]]",
    "{}",
    "[1, 2]",
    "['roll', 'pitch']",
    "{ roll = 1.0 }",
    "'quadrotor'",
    "'helicopter-hover'",
    "'lockstep'",
    "'zenoh'",
    "'inproc'",
    "'smc'",
    "'ppc'",
    "'manual'",
    "'kinematic'",
    "'tcp/0.0.0.0:0'",
    "'udpin://127.0.0.1:1'",
    "\"\\u0000\"",
    "'..'",
    "1979-05-27",
    "=",
    "[",
    "\"",
    "#",
    "\u{fe0f}",
    "[nodes.plant]\n",
    "[[variants]]\nname = 'a'\nset = { seed = 2 }\n",
];

/// Most edits of an input.
const EDITS: usize = 6;

struct Inputs(Stream);

impl Inputs {
    fn below(&mut self, most: usize) -> usize {
        ((self.0.uniform() * most as f64) as usize).min(most.saturating_sub(1))
    }

    fn word(&mut self) -> &'static str {
        WORDS[self.below(WORDS.len())]
    }

    /// A line of any built-in file.
    fn line(&mut self) -> &'static str {
        let lines: Vec<_> = BUILTIN[self.below(BUILTIN.len())].1.lines().collect();
        lines[self.below(lines.len())]
    }

    /// A file with some damage.
    fn next(&mut self) -> String {
        let text = BUILTIN[self.below(BUILTIN.len())].1;
        let mut lines: Vec<String> = text.lines().map(String::from).collect();
        for _ in 0..1 + self.below(EDITS) {
            let at = self.below(lines.len());
            match self.below(8) {
                0 => _ = lines.remove(at),
                1 => lines.insert(at, self.line().into()),
                2 => lines.insert(at, self.word().into()),
                3 => lines.truncate(at),
                4 => lines.insert(at, lines[at].clone()),
                5 => {
                    let mut characters: Vec<char> = lines[at].chars().collect();
                    let (from, word) = (self.below(characters.len()), self.word());
                    let to = (from + self.below(3)).min(characters.len());
                    characters.splice(from..to, word.chars());
                    lines[at] = characters.into_iter().collect();
                }
                _ => {
                    if let Some((key, _)) = lines[at].split_once('=') {
                        lines[at] = format!("{key}= {}", self.word());
                    }
                }
            }
            if lines.is_empty() {
                break;
            }
        }
        lines.join("\n")
    }
}

fn read(text: &str) -> Result<Jobs, LaunchError> {
    let document = Document::parse("a.toml", text)?;
    jobs_of(&FoundFile { document, name: "a".into(), folder: ".".into() }, &OverrideArgs::default(), false)
}

/// A file that can be read can be started: its configuration reaches the nodes unchanged.
fn check(text: &str) {
    let jobs = match read(text) {
        Ok(jobs) => jobs,
        Err(error) => {
            assert!(error.to_string().contains("a.toml"), "{error}");
            return;
        }
    };
    for job in jobs.runs {
        let config = job.plan.config;
        assert!(config.period_ns > 0, "a rate without a period");
        let sent = serde_json::to_string(&config).unwrap_or_else(|e| panic!("{e}"));
        let heard: NodeConfig = serde_json::from_str(&sent).unwrap_or_else(|e| panic!("{e}: {sent}"));
        assert_eq!(heard, config);
    }
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

#[test]
fn any_damage_is_an_error_or_a_bench_that_can_be_started() {
    let seed = number("WHIRLSTAND_FUZZ_SEED", 1);
    let mut inputs = Inputs(Stream::new(seed, "launch files"));
    for n in 0..number("WHIRLSTAND_FUZZ_INPUTS", 3000) {
        let text = inputs.next();
        assert!(catch_unwind(|| check(&text)).is_ok(), "input {n} of seed {seed}:\n{text}");
    }
}
