//! Load: records on an even grid.

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use crate::answer::DataFinding;
use crate::data::checks;
use crate::data::record::{Data, coarser_period};
use crate::{DiagnoseError, Options};

/// Records as the diagnosis sees them, and what they show by themselves.
#[derive(Debug, Clone)]
pub(crate) struct Loaded<'a> {
    pub records: &'a [Record],
    pub vehicle: &'a Vehicle,
    pub options: &'a Options,
    pub data: Data,
    /// What clocks and numbers show.
    pub found: Vec<DataFinding>,
    /// That the record is not of this vehicle, where nothing is wrong with the channels.
    pub stranger: Option<DataFinding>,
    /// For how long the likeliest predictor remembers of those that follow the records, s, where that is asked for.
    pub likeliest_s: Option<f64>,
}

impl<'a> Loaded<'a> {
    /// Reads at least one record.
    ///
    /// # Errors
    /// When an input or every output is missing, a record is too short, or their periods differ.
    pub fn new(
        records: &'a [Record],
        vehicle: &'a Vehicle,
        options: &'a Options,
    ) -> Result<Self, DiagnoseError> {
        let coarser = if options.period_s.is_none() { coarser_period(records) } else { None };
        let data = Data::join(records, vehicle, options.period_s.or(coarser))?;
        let mut found: Vec<_> = records.iter().flat_map(|r| checks::record(r, vehicle)).collect();
        found.extend(coarser.map(checks::thinned));
        Ok(Self { records, vehicle, options, data, found, stranger: None, likeliest_s: None })
    }

    /// The same for a predictor that follows the records and remembers for so long, s. Predictions ahead are those of the
    /// likeliest.
    pub fn remembering(&self, memory_s: f64, likeliest_s: f64) -> Self {
        let data = Data { memory_s: Some(memory_s), ..self.data.clone() };
        Self { data, likeliest_s: Some(likeliest_s), ..self.clone() }
    }

    /// The same with the first commands of each record as they were before it: what came before a record nobody knows.
    pub fn held(&self) -> Self {
        Self { data: Data { held: true, ..self.data.clone() }, ..self.clone() }
    }
}
