//! The plan of a trial. It depends on the trial's number only, so that all effects are equally frequent and
//! any trial can be repeated.

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Kind;

use super::generator::Generator;
use super::out_of_library::OutOfLibrary;
use super::random::RandomStream;
use super::ranges::OutOfLibraryRange;

/// Largest number of trials of one seed; a trial number is the seed times this plus a count.
pub const TRIALS_PER_SEED: u64 = 1_000_000;

/// Kind of trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Case {
    /// One effect of the table.
    Single,
    /// No effect.
    Clean,
    /// Two effects of the table.
    Pair,
    /// One effect that is not in the table.
    Outside,
}

impl Case {
    /// All kinds of trial.
    pub const ALL: [Self; 4] = [Self::Single, Self::Clean, Self::Pair, Self::Outside];

    /// Name of the kind on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Clean => "clean",
            Self::Pair => "pair",
            Self::Outside => "outside",
        }
    }
}

/// Whether the trials are flown in open or closed loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Loops {
    /// Open loop: the commands are drawn.
    #[default]
    Open,
    /// Closed loop: a control law computes the commands from noisy measurements.
    Closed,
    /// Every second trial is in closed loop.
    Both,
}

/// The effects and settings of a trial.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    /// Number of the trial.
    pub number: u64,
    /// Generator from which the trial is drawn.
    pub generator: Generator,
    /// Kind of trial.
    pub case: Case,
    /// Hidden effects of the table.
    pub effects: Vec<Kind>,
    /// Hidden effect outside the table.
    pub outside: Option<OutOfLibrary>,
    /// Whether a control law flies the vehicle, so that the record holds its commands.
    pub closed_loop: bool,
    /// Index of this trial among those of its case; it selects the noise colour of clean records in turn.
    pub ordinal: u64,
}

/// Case of each trial in a round of 25: 14 single (s), 3 clean (c), 5 pairs (p), 3 outside (o).
const ROUND: &[u8; 25] = b"sspsscsspssosspscspssocop";

impl Plan {
    /// The plan of a trial.
    pub fn new(number: u64, generator: Generator, loops: Loops) -> Self {
        let count = number % TRIALS_PER_SEED;
        let (round, place) = (count / ROUND.len() as u64, (count % ROUND.len() as u64) as usize);
        let letter = ROUND[place];
        let of = |slots: &[u8]| slots.iter().filter(|l| **l == letter).count() as u64;
        let ordinal = round * of(ROUND) + of(&ROUND[..place]);
        let kinds: Vec<Kind> = Kind::all().collect();
        let closed_loop = match loops {
            Loops::Open => false,
            Loops::Closed => true,
            Loops::Both => number % 2 == 1,
        };
        let mut plan = Self {
            number,
            generator,
            case: Case::Clean,
            effects: Vec::new(),
            outside: None,
            closed_loop,
            ordinal,
        };
        match letter {
            b's' => {
                plan.case = Case::Single;
                plan.effects.push(kinds[(ordinal % kinds.len() as u64) as usize]);
            }
            b'p' => {
                plan.case = Case::Pair;
                let mut stream = RandomStream::new(number, "pair");
                let first = stream.below(kinds.len());
                let second = (first + 1 + stream.below(kinds.len() - 1)) % kinds.len();
                plan.effects.extend([kinds[first], kinds[second]]);
            }
            b'o' => {
                plan.case = Case::Outside;
                let outside = generator.ranges().outside;
                plan.outside = Some(outside[(ordinal % outside.len() as u64) as usize].kind);
            }
            _ => {}
        }
        plan
    }

    /// The ranges of the plan's effect outside the table.
    pub(crate) fn outside_range(&self) -> Option<&'static OutOfLibraryRange> {
        self.generator.ranges().outside.iter().find(|range| Some(range.kind) == self.outside)
    }

    /// Whether the plan is of one of these cases and hides only these effects of the table; an empty list is
    /// no restriction.
    pub fn wanted(&self, cases: &[Case], effects: &[Kind]) -> bool {
        let case = cases.is_empty() || cases.contains(&self.case);
        case && (effects.is_empty() || self.effects.iter().all(|e| effects.contains(e)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixty_trials_hide_every_effect_of_the_table_once_at_least() {
        let plans: Vec<Plan> = (3_000_000..3_000_060)
            .map(|number| Plan::new(number, Generator::Reference, Loops::Open))
            .collect();
        for kind in Kind::all() {
            assert!(plans.iter().any(|p| p.case == Case::Single && p.effects == [kind]), "{kind}");
        }
        for case in Case::ALL {
            assert!(plans.iter().any(|p| p.case == case));
        }
        assert!(plans.iter().all(|p| p.case != Case::Pair || p.effects[0] != p.effects[1]));
    }
}
