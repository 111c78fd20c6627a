//! One decoder per message encoding.

use prost_reflect::prost::Message as _;
use prost_reflect::prost_types::FileDescriptorSet;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, ReflectMessage, Value};

use super::ros::Definition;
use super::visit::{MOST_ELEMENTS, MOST_NESTING, PathStack, Visit};
use super::wire::Wire;
use crate::log_file::Topic;

/// Decodes the messages of one topic.
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
            ("protobuf", "protobuf") => descriptor(topic).map(Self::Protobuf),
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

/// The description of a topic's messages.
fn descriptor(topic: &Topic) -> Result<MessageDescriptor, String> {
    let damaged = |e: &dyn std::fmt::Display| format!("its protobuf descriptors are damaged: {e}");
    let files = FileDescriptorSet::decode(topic.schema.as_slice()).map_err(|e| damaged(&e))?;
    // The syntax is checked here, because the pool would index a file that it has not kept to report another
    // one.
    let known = |syntax: &str| matches!(syntax, "proto2" | "proto3");
    if let Some(syntax) = files.file.iter().filter_map(|file| file.syntax.as_deref()).find(|s| !known(s)) {
        return Err(format!("its protobuf descriptors have syntax '{syntax}': proto2 or proto3 is expected"));
    }
    DescriptorPool::from_file_descriptor_set(files)
        .map_err(|e| damaged(&e))?
        .get_message_by_name(&topic.schema_name)
        .ok_or_else(|| format!("its protobuf descriptors have no {}", topic.schema_name))
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
        // An absent message has no numbers; an absent number is 0.
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

#[cfg(test)]
mod tests {
    use super::*;
    use prost_reflect::prost_types::{DescriptorProto, FileDescriptorProto};

    fn reason(syntax: Option<&str>, message: &str) -> Option<String> {
        let message_type = vec![DescriptorProto { name: Some("Sample".into()), ..Default::default() }];
        let syntax = syntax.map(Into::into);
        let file =
            FileDescriptorProto { name: Some("a.proto".into()), message_type, syntax, ..Default::default() };
        let topic = Topic {
            name: "/a".into(),
            message_encoding: "protobuf".into(),
            schema_name: message.into(),
            schema_encoding: "protobuf".into(),
            schema: FileDescriptorSet { file: vec![file] }.encode_to_vec(),
            layout: Vec::new(),
        };
        Decoder::new(&topic).err()
    }

    #[test]
    fn a_syntax_of_protobuf_that_is_not_known_is_refused_by_its_name() {
        for syntax in [None, Some("proto2"), Some("proto3")] {
            assert_eq!(reason(syntax, "Sample"), None, "{syntax:?}");
        }
        for syntax in ["editions", "", "proto4"] {
            let reason = reason(Some(syntax), "Sample").unwrap();
            assert!(reason.contains(&format!("syntax '{syntax}': proto2 or proto3 is expected")), "{reason}");
        }
        assert!(reason(Some("proto3"), "Other").unwrap().contains("have no Other"));
    }
}
