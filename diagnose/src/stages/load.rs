//! Load stage: records on an even grid.

use std::sync::Arc;

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use crate::answer::DataFinding;
use crate::data::checks;
use crate::data::record::{Data, StateFilter, coarser_period};
use crate::{DiagnoseError, Options};

/// Records on an even grid, with the findings on them.
#[derive(Debug, Clone)]
pub(crate) struct Loaded<'a> {
    /// Files of the records.
    pub origins: Vec<String>,
    pub vehicle: &'a Vehicle,
    pub options: &'a Options,
    pub data: Data,
    /// Findings on clocks and values.
    pub found: Vec<DataFinding>,
    /// Finding that the record is of another vehicle, where the channels are otherwise correct.
    pub stranger: Option<DataFinding>,
}

impl<'a> Loaded<'a> {
    /// Loads one or more records.
    ///
    /// # Errors
    /// When an input or every output is missing, a record is too short, or their periods differ.
    pub fn new(
        records: &[Record],
        vehicle: &'a Vehicle,
        options: &'a Options,
    ) -> Result<Self, DiagnoseError> {
        let coarser = if options.period_s.is_none() { coarser_period(records) } else { None };
        let data = Data::join(records, vehicle, options.period_s.or(coarser))?;
        let mut found: Vec<_> = records.iter().flat_map(|r| checks::record(r, vehicle)).collect();
        found.extend(coarser.map(checks::thinned));
        let origins = records.iter().map(|r| r.origin.clone()).collect();
        Ok(Self { origins, vehicle, options, data, found, stranger: None })
    }

    /// The same records for a predictor that follows them with a memory of `memory_s`. Predictions over the
    /// horizon use the most likely memory, and causes are compared with what the likeliest `filter` says.
    pub fn remembering(&self, memory_s: f64, likeliest_s: f64, filter: Arc<StateFilter>) -> Self {
        let data = Data {
            memory_s: Some(memory_s),
            likeliest_s: Some(likeliest_s),
            likeliest_filter: Some(filter),
            ..self.data.clone()
        };
        Self { data, ..self.clone() }
    }

    /// The same records with their first commands assumed to have been applied before they began: commands
    /// before a record are unknown.
    pub fn held(&self) -> Self {
        Self { data: Data { held: true, ..self.data.clone() }, ..self.clone() }
    }
}
