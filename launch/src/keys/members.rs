//! The members of a bench, and the topics that each may publish.

use whirlstand_bus::{Member, Writes};
use whirlstand_nodes::topics::{of_the_loop, published_by};

use crate::file::{Plan, PlannedNode};

/// Name of the launcher, which subscribes to `Health`.
pub(crate) const LAUNCHER: &str = "launcher";

/// Member name of outside viewers: they receive every topic and publish none.
pub(crate) const OBSERVER: &str = "observer";

/// Member name of outside programs that publish: topics of their own, `inject` and `pilot`, but none of the
/// loop.
pub(crate) const GUEST: &str = "guest";

/// All members of a planned bench. A node with the name of a standard member is that member.
pub(super) fn members(plan: &Plan) -> Vec<Member> {
    let mut members: Vec<Member> =
        plan.nodes.iter().map(|node| Member { name: node.name.clone(), writes: writes(node) }).collect();
    for (name, writes) in [(LAUNCHER, Writes::Nothing), (OBSERVER, Writes::Nothing), (GUEST, own_topics())] {
        if members.iter().all(|m| m.name != name) {
            members.push(Member { name: name.into(), writes });
        }
    }
    members
}

fn writes(node: &PlannedNode) -> Writes {
    match node.role {
        Some(role) => Writes::Only(published_by(role).iter().map(|t| (*t).into()).collect()),
        None => own_topics(),
    }
}

fn own_topics() -> Writes {
    Writes::AllBut(of_the_loop().into_iter().map(Into::into).collect())
}
