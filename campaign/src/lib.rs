//! Campaigns of many flights of one launch file: the quantities that vary, and the statistics of the flights.
//!
//! A [`Campaign`] is read from its file. For every flight it draws the values of the varying keys, by the flight's
//! number alone. The caller flies them and returns [`Flight`]s, which [`Table`] stores in a Parquet file and
//! [`Findings`] summarises. This room flies nothing and knows neither launch files nor vehicles.

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
