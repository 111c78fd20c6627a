//! Access to a running bench from outside: its description, joining it, requesting a change, and following its
//! messages.

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
