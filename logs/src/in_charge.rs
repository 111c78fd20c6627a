//! The part of a record in which the controller had control of a vehicle behind a bridge. Other parts do not show
//! how the vehicle responds to the controller's inputs.

use whirlstand_msgs::charge;

use crate::bench_record::IN_CHARGE;
use crate::record::Record;

/// The stretches of a record in which the controller was in charge.
#[derive(Debug, Clone, PartialEq)]
pub struct InCharge {
    /// Whether the controller was in charge, for each point of the record.
    points: Vec<bool>,
    whole_s: f64,
}

impl InCharge {
    /// The stretches of a record; `None` for one that was not flown behind a bridge. A state of charge holds until
    /// the next message on it.
    pub fn of(record: &Record) -> Option<Self> {
        let said = record.get(IN_CHARGE)?;
        let mut ours = false;
        let points = said.values.iter().map(|value| {
            if value.is_finite() {
                ours = *value == f64::from(charge::CONTROLLER);
            }
            ours
        });
        Some(Self { points: points.collect(), whole_s: record.duration() })
    }

    /// Whether the controller was in charge all the time.
    pub fn is_whole(&self) -> bool {
        self.points.iter().all(|ours| *ours)
    }

    /// Whether the controller was never in charge.
    pub fn is_never(&self) -> bool {
        !self.points.contains(&true)
    }

    /// The record without the parts in which the controller was not in charge.
    pub fn part_of(&self, record: &Record) -> Record {
        record.keep(&self.points)
    }

    /// Text on how long the controller was in charge, and in how many stretches.
    pub fn text(&self) -> String {
        let count = self.points.iter().filter(|ours| **ours).count();
        let begins = self.points.windows(2).filter(|pair| !pair[0] && pair[1]).count();
        let stretches = begins + usize::from(self.points.first() == Some(&true));
        let share = count as f64 / self.points.len().max(1) as f64;
        format!(
            "the controller was in charge for {:.1} s of {:.1} s, in {stretches} stretch{}; nothing else is used",
            share * self.whole_s,
            self.whole_s,
            if stretches == 1 { "" } else { "es" }
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_pilot_flew_is_left_out_and_told() {
        let time: Vec<f64> = (0..9).map(f64::from).collect();
        let mut record = Record::new("log.mcap", time).unwrap();
        record.push("roll", "rad", (0..9).map(f64::from).collect()).unwrap();
        assert_eq!(InCharge::of(&record), None, "no bridge");
        let nan = f64::NAN;
        let said = vec![nan, 0.0, 2.0, nan, 1.0, 1.0, 2.0, 2.0, 3.0];
        record.push(IN_CHARGE, "", said).unwrap();
        let charge = InCharge::of(&record).unwrap();
        assert!(!charge.is_whole() && !charge.is_never());
        let part = charge.part_of(&record);
        assert_eq!(part.time, [2.0, 3.0, 6.0, 7.0]);
        assert_eq!(part.get("roll").unwrap().values, [2.0, 3.0, 6.0, 7.0]);
        assert_eq!(
            charge.text(),
            "the controller was in charge for 3.6 s of 8.0 s, in 2 stretches; nothing else is used"
        );
    }
}
