//! A bench that runs, seen from outside: what it is, joining it, asking it for a change, and following what it says.

mod ask;
mod card;
mod follow;
mod hand;
mod look;
mod page;
mod remote;
mod shown;
mod told;
mod wanted;

pub(crate) use ask::ask;
pub(crate) use card::BenchCard;
pub(crate) use follow::follow;
pub(crate) use look::{Look, Seen};
pub(crate) use page::{LiveAddresses, LivePage, Looker};
pub(crate) use told::Told;
pub(crate) use wanted::Wanted;
