//! The members of a bench, and what each may publish.

use whirlstand_bus::{Member, Writes};
use whirlstand_nodes::topics::{of_the_loop, published_by};

use crate::file::{Plan, PlannedNode};

/// The launcher itself; it listens to `Health`.
pub(crate) const LAUNCHER: &str = "launcher";

/// Whoever looks at the bench from outside: it hears everything and publishes nothing.
pub(crate) const OBSERVER: &str = "observer";

/// A program from outside that has something to say: topics of its own, `inject`, `pilot`; none of the loop.
pub(crate) const GUEST: &str = "guest";

/// All members of a planned bench. A node may bear the name of one that every bench has; it then is that one.
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
