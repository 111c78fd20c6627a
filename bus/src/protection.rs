//! Protection of a bench over Zenoh: mutual TLS authenticates the nodes, access control limits what they may
//! publish.
//!
//! Zenoh's user and password are not used: they authenticate only the connecting side, so that a node could
//! not verify who answers at a peer's address. With certificates both sides of every link are known by their
//! common name.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use whirlstand_msgs::{Health, Message};

use crate::network_keys::{key_expression, spoken_key};

/// The environment variable, and its value, with which Zenoh reads and writes on one thread. A process that speaks TLS needs
/// it before it opens its first session: Zenoh 1.10 lends one TLS stream to the reading and to the writing task at the same
/// time (`zenoh-link-tls/src/unicast.rs`), and where they run on two threads a link breaks now and then with "handshake
/// not complete", or the process ends with a memory fault. On one thread neither sees the stream half changed by the other.
/// A session that speaks TLS is refused without it ([`crate::OpenError::TwoThreads`]).
pub const ONE_THREAD: (&str, &str) = ("ZENOH_RUNTIME", "(rx: (handover: tx), tx: (worker_threads: 1))");

/// Settings with which a node joins a protected bench.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Protection {
    /// Identity of this node.
    pub identity: Identity,
    /// All members of the bench. A node with another certificate can connect, but neither publish nor
    /// subscribe.
    pub members: Vec<Member>,
}

/// Key and certificate of a node, and the certificate of the authority that signed the others; all in PEM.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Certificate of the authority.
    pub authority: String,
    /// Certificate of the node; its common name is the node's name.
    pub certificate: String,
    /// Private key of the node.
    pub key: String,
}

/// Omits the key, as configurations are printed.
impl std::fmt::Debug for Identity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Identity").finish_non_exhaustive()
    }
}

/// A member of a bench. All members may subscribe to all topics.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// The node's name.
    pub name: String,
    /// Topics that it may publish.
    pub writes: Writes,
}

/// Topics that a member may publish.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Writes {
    /// No topic: the member only listens.
    Nothing,
    /// Only these topics, and its own `Health`.
    Only(Vec<String>),
    /// Any topic except these, and its own `Health`.
    AllBut(Vec<String>),
}

impl Writes {
    /// Key expressions that are allowed, and exceptions that are denied.
    fn keys(&self, bench: &str, name: &str) -> (Vec<String>, Vec<String>) {
        let key = |topic: &String| key_expression(bench, topic);
        let health = spoken_key(bench, Health::TOPIC, name);
        match self {
            Self::Nothing => (Vec::new(), Vec::new()),
            Self::Only(topics) => (topics.iter().map(key).chain([health]).collect(), Vec::new()),
            Self::AllBut(topics) => {
                let own = key_expression(bench, &format!("{name}/**"));
                (vec![key_expression(bench, "*"), own, health], topics.iter().map(key).collect())
            }
        }
    }
}

/// Zenoh's `access_control` for a bench, which denies everything by default.
pub(crate) fn access_control(bench: &str, members: &[Member]) -> Value {
    let all = key_expression(bench, "**");
    let mut rules = vec![
        json!({ "id": "subscribe", "permission": "allow", "flows": ["ingress"],
                "messages": ["declare_subscriber"], "key_exprs": [all] }),
        // Confidentiality needs no rule: other programs are not members.
        json!({ "id": "send", "permission": "allow", "flows": ["egress"],
                "messages": ["put", "declare_subscriber"], "key_exprs": [all] }),
    ];
    let names: Vec<&str> = members.iter().map(|m| m.name.as_str()).collect();
    let mut subjects = vec![json!({ "id": "members", "cert_common_names": names })];
    let mut policies = vec![json!({ "rules": ["subscribe", "send"], "subjects": ["members"] })];
    for member in members {
        let (allowed, denied) = member.writes.keys(bench, &member.name);
        let mut own = Vec::new();
        for (permission, keys) in [("allow", allowed), ("deny", denied)] {
            if !keys.is_empty() {
                let id = format!("{permission} {}", member.name);
                own.push(id.clone());
                rules.push(json!({ "id": id, "permission": permission, "flows": ["ingress"],
                                   "messages": ["put"], "key_exprs": keys }));
            }
        }
        if !own.is_empty() {
            let subject = format!("member {}", member.name);
            subjects.push(json!({ "id": subject, "cert_common_names": [member.name] }));
            policies.push(json!({ "rules": own, "subjects": [subject] }));
        }
    }
    json!({ "enabled": true, "default_permission": "deny",
            "rules": rules, "subjects": subjects, "policies": policies })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_not_printed() {
        let identity = Identity { authority: "a".into(), certificate: "c".into(), key: "hidden".into() };
        let protection = Protection { identity, members: Vec::new() };
        assert!(!format!("{protection:?}").contains("hidden"));
    }

    #[test]
    fn everybody_has_the_rights_of_the_list_and_no_other() {
        let members = [
            Member { name: "plant".into(), writes: Writes::Only(vec!["imu".into()]) },
            Member { name: "guest".into(), writes: Writes::AllBut(vec!["imu".into()]) },
            Member { name: "observer".into(), writes: Writes::Nothing },
        ];
        let access = access_control("lab", &members);
        let rule = |id: &str| {
            let rules = access["rules"].as_array().unwrap();
            rules.iter().find(|r| r["id"] == id).map(|r| r["key_exprs"].clone())
        };
        assert_eq!(access["default_permission"], "deny");
        assert_eq!(rule("allow plant"), Some(json!(["whirlstand/lab/imu", "whirlstand/lab/health/plant"])));
        assert_eq!(rule("deny guest"), Some(json!(["whirlstand/lab/imu"])));
        assert_eq!(
            rule("allow guest"),
            Some(json!(["whirlstand/lab/*", "whirlstand/lab/guest/**", "whirlstand/lab/health/guest"]))
        );
        assert_eq!(rule("allow observer"), None);
    }
}
