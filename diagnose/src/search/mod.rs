//! Search for causes among the candidates: survey, selection, acceptance.

pub mod acceptance;
mod agreement;
pub mod alternative;
pub mod cross_validation;
pub mod equivalence;
mod merge;
pub mod refit;
pub mod select;
pub mod selection;
mod settle;
pub mod survey;
pub mod survey_cache;
mod survey_order;
mod without;
