//! Names of published topics in `rmw_zenoh`: key expressions, liveliness tokens, attachments.
//!
//! Source: the design document and code of <https://github.com/ros2/rmw_zenoh> (`docs/design.md`,
//! `rmw_zenoh_cpp/src/detail/liveliness_utils.cpp`), and for attachments those of version 0.2.4 on, whose
//! three fields have no names.

use super::messages::RosType;

/// Quality of service of all topics, in the token's format: every part is rmw_zenoh's default (reliable,
/// volatile, the last 10 kept).
const QOS: &str = "::,:,:,:,,";

/// ROS 2 node of the relay.
#[derive(Debug, Clone)]
pub struct RosNode {
    /// Number of the domain (`ROS_DOMAIN_ID`).
    pub domain: u32,
    /// Namespace, `/` or `/drone` or longer.
    pub namespace: String,
    /// Name of the node.
    pub name: String,
}

/// Entity described by a liveliness token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entity {
    Publisher,
    Subscription,
}

/// Replaces slashes, which are not allowed within a part of a token.
fn mangled(text: &str) -> String {
    text.replace('/', "%")
}

impl RosNode {
    /// The full name of a topic of this node.
    pub fn topic(&self, name: &str) -> String {
        if name.starts_with('/') {
            return name.into();
        }
        format!("{}/{name}", self.namespace.trim_end_matches('/'))
    }

    /// Key expression of the messages of a topic.
    pub fn key<T: RosType>(&self, topic: &str) -> String {
        format!("{}/{}/{}/{}", self.domain, topic.trim_matches('/'), T::NAME, T::HASH)
    }

    /// The token of the node itself, of the Zenoh session `zid`.
    pub fn token(&self, zid: &str) -> String {
        format!("@ros2_lv/{}/{zid}/0/0/NN/{}", self.domain, self.place())
    }

    /// The token of a publisher or subscription; `id` counts those of the node from 1.
    pub fn token_of<T: RosType>(&self, zid: &str, id: usize, entity: Entity, topic: &str) -> String {
        let entity = match entity {
            Entity::Publisher => "MP",
            Entity::Subscription => "MS",
        };
        let (domain, place, topic) = (self.domain, self.place(), mangled(topic));
        format!("@ros2_lv/{domain}/{zid}/0/{id}/{entity}/{place}/{topic}/{}/{}/{QOS}", T::NAME, T::HASH)
    }

    /// Enclave, namespace and name.
    fn place(&self) -> String {
        format!("%/{}/{}", mangled(&self.namespace), mangled(&self.name))
    }
}

/// Global identifier of a publisher: the hash of the token, XXH3 with 128 bits, its lower half first.
pub fn gid(token: &str) -> [u8; 16] {
    twox_hash::XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// Attachment of a message: its number, its publication time (Unix, ns), and its publisher, in Zenoh's
/// serialisation.
pub fn attachment(number: i64, time_ns: i64, gid: [u8; 16]) -> Vec<u8> {
    [&number.to_le_bytes()[..], &time_ns.to_le_bytes(), &[gid.len() as u8], &gid].concat()
}

#[cfg(test)]
mod tests {
    use super::super::messages::Imu;
    use super::*;

    #[test]
    fn names_are_those_of_the_design_document() {
        let node = RosNode { domain: 3, namespace: "/".into(), name: "whirlstand".into() };
        let hash = Imu::HASH;
        let topic = node.topic("imu");
        assert_eq!(topic, "/imu");
        assert_eq!(node.key::<Imu>(&topic), format!("3/imu/sensor_msgs::msg::dds_::Imu_/{hash}"));
        assert_eq!(node.token("ab12"), "@ros2_lv/3/ab12/0/0/NN/%/%/whirlstand");
        assert_eq!(
            node.token_of::<Imu>("ab12", 2, Entity::Publisher, &topic),
            format!(
                "@ros2_lv/3/ab12/0/2/MP/%/%/whirlstand/%imu/sensor_msgs::msg::dds_::Imu_/{hash}/::,:,:,:,,"
            )
        );
        let inner = RosNode { namespace: "/lab/one".into(), ..node };
        assert_eq!(inner.topic("imu"), "/lab/one/imu");
        assert_eq!(inner.topic("/tf"), "/tf");
        assert_eq!(inner.token("ab12"), "@ros2_lv/3/ab12/0/0/NN/%/%lab%one/whirlstand");
    }

    #[test]
    fn an_attachment_has_33_bytes_in_the_order_of_the_fields() {
        let bytes = attachment(1, 2, [7; 16]);
        assert_eq!(bytes.len(), 33);
        assert_eq!((bytes[0], bytes[8], bytes[16]), (1, 2, 16));
        assert_eq!(bytes[17..], [7; 16]);
    }
}
