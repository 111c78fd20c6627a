//! One decoder per message encoding.

use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, ReflectMessage, Value};

use super::ros::Definition;
use super::visit::{MOST_ELEMENTS, MOST_NESTING, PathStack, Visit};
use super::wire::Wire;
use crate::log_file::Topic;

/// Takes the messages of one topic apart.
pub(super) enum Decoder {
    Json,
    Ros(Definition, Wire),
    Protobuf(MessageDescriptor),
}

impl Decoder {
    /// The decoder for a topic; the error is the reason why there is none.
    pub fn new(topic: &Topic) -> Result<Self, String> {
        let text =
            || String::from_utf8(topic.schema.clone()).map_err(|_| "its schema is not text".to_string());
        match (topic.message_encoding.as_str(), topic.schema_encoding.as_str()) {
            ("json", _) => Ok(Self::Json),
            ("cdr", "ros2msg") => Ok(Self::Ros(Definition::parse(&topic.schema_name, &text()?)?, Wire::Cdr)),
            ("ros1", "ros1msg") => {
                Ok(Self::Ros(Definition::parse(&topic.schema_name, &text()?)?, Wire::Ros1))
            }
            ("protobuf", "protobuf") => DescriptorPool::decode(topic.schema.as_slice())
                .map_err(|e| format!("its protobuf descriptors are damaged: {e}"))?
                .get_message_by_name(&topic.schema_name)
                .map(Self::Protobuf)
                .ok_or_else(|| format!("its protobuf descriptors have no {}", topic.schema_name)),
            (message, schema) => {
                Err(format!("messages in '{message}' with a schema in '{schema}' are not supported"))
            }
        }
    }

    /// Visits every number of a message.
    pub fn visit(&self, data: &[u8], visit: &mut Visit<'_>) -> Result<(), String> {
        match self {
            Self::Json => {
                let value = serde_json::from_slice(data).map_err(|e| format!("not JSON: {e}"))?;
                json(&value, &mut PathStack::new(), visit);
                Ok(())
            }
            Self::Ros(definition, wire) => wire.visit(definition, data, visit),
            Self::Protobuf(descriptor) => {
                let message = DynamicMessage::decode(descriptor.clone(), data)
                    .map_err(|e| format!("not {}: {e}", descriptor.full_name()))?;
                protobuf(&message, &mut PathStack::new(), visit, 0);
                Ok(())
            }
        }
    }
}

fn json(value: &serde_json::Value, path: &mut PathStack, visit: &mut Visit<'_>) {
    match value {
        serde_json::Value::Number(n) => {
            if let Some(number) = n.as_f64() {
                visit(&path.text, number);
            }
        }
        serde_json::Value::Bool(b) => visit(&path.text, f64::from(u8::from(*b))),
        serde_json::Value::Object(fields) => {
            for (name, field) in fields {
                path.field(name, |path| json(field, path, visit));
            }
        }
        serde_json::Value::Array(elements) if elements.len() <= MOST_ELEMENTS => {
            for (i, element) in elements.iter().enumerate() {
                path.element(i, |path| json(element, path, visit));
            }
        }
        _ => {}
    }
}

fn protobuf(message: &DynamicMessage, path: &mut PathStack, visit: &mut Visit<'_>, depth: usize) {
    if depth > MOST_NESTING {
        return;
    }
    for field in message.descriptor().fields() {
        // A message that is not there has no numbers; a number that is not there is 0.
        if field.supports_presence() && !message.has_field(&field) {
            continue;
        }
        let value = message.get_field(&field);
        path.field(field.name(), |path| protobuf_value(&value, path, visit, depth));
    }
}

fn protobuf_value(value: &Value, path: &mut PathStack, visit: &mut Visit<'_>, depth: usize) {
    let number = match value {
        Value::Bool(b) => f64::from(u8::from(*b)),
        Value::I32(n) | Value::EnumNumber(n) => f64::from(*n),
        Value::U32(n) => f64::from(*n),
        Value::I64(n) => *n as f64,
        Value::U64(n) => *n as f64,
        Value::F32(n) => f64::from(*n),
        Value::F64(n) => *n,
        Value::Message(inner) => return protobuf(inner, path, visit, depth + 1),
        Value::List(elements) if elements.len() <= MOST_ELEMENTS => {
            for (i, element) in elements.iter().enumerate() {
                path.element(i, |path| protobuf_value(element, path, visit, depth + 1));
            }
            return;
        }
        _ => return,
    };
    visit(&path.text, number);
}
