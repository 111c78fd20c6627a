//! Many flights of one launch file: what varies between them, and what they say together.
//!
//! A [`Campaign`] is read from its file; it draws for every flight, by the flight's number alone, the values of the keys that
//! vary. Who flies them gives back [`Flight`]s, which [`Table`] keeps in a Parquet file and [`Findings`] sums up. Nothing here
//! flies: the room knows neither launch files nor vehicles.

mod correlation;
mod draw;
mod file;
mod findings;
mod importance;
mod proportion;
mod quantity;
mod shard;
mod source;
mod table;
mod together;
mod variation;

pub use correlation::{correlation_root, rank_correlation};
pub use draw::{DrawError, Method};
pub use file::{Campaign, CampaignError};
pub use findings::{FigureFindings, Findings, LimitFindings, Sensitivity, Worst, violated};
pub use proportion::{Proportion, more_often_in_pairs};
pub use quantity::{Number, Quantity, Spread, Value, Variation};
pub use shard::{PartsError, Shard};
pub use table::{Columns, Ended, FigureColumn, Flight, Table, TableError, TableInfo, WEIGHT};
