//! Options of a diagnosis.

use whirlstand_logs::Record;

use crate::Watch;

/// Options of a diagnosis.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Period, s; the record's own when `None`.
    pub period_s: Option<f64>,
    /// True when the vehicle's free parameters are estimates that may be refitted; `None`: they are when the
    /// vehicle file says that they were identified from a record.
    pub refit: Option<bool>,
    /// Vehicles whose flight mode the record may change to, beside the built-in ones.
    pub modes: Vec<String>,
    /// Horizon over which predictions are judged, s; derived from the vehicle's time constants when `None`.
    pub horizon_s: Option<f64>,
    /// A record on the ground with the engine on.
    pub engine_on: Option<Record>,
    /// A record with the engine off.
    pub engine_off: Option<Record>,
    /// Receives progress and can stop the search.
    pub watch: Watch,
}
