//! Message definitions of ROS 1 and ROS 2 as MCAP stores them: the message's own text, then, after a line of
//! `=` and `MSG: package/Name`, the text of each type that it uses (MCAP format registry, "ros1msg",
//! "ros2msg").

use std::collections::HashMap;

/// Type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
    String,
    /// ROS 1 `time`: two u32.
    Time,
    /// ROS 1 `duration`: two i32.
    Duration,
    /// Index into [`Definition::types`].
    Message(usize),
}

/// Number of elements of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Count {
    One,
    Fixed(usize),
    Sequence,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub name: String,
    pub kind: Kind,
    pub count: Count,
}

/// A message type and all types that it uses; it is the first of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Definition {
    pub types: Vec<Vec<Field>>,
}

/// A field whose type has not been resolved.
struct Raw<'a> {
    type_name: &'a str,
    name: &'a str,
    count: Count,
}

impl Definition {
    /// Parses a definition; the error is a sentence for the user.
    pub fn parse(type_name: &str, text: &str) -> Result<Self, String> {
        let mut names = vec![bare(type_name)];
        let mut bodies: Vec<Vec<Raw<'_>>> = vec![Vec::new()];
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or("").trim();
            if let Some(name) = line.strip_prefix("MSG:") {
                names.push(bare(name.trim()));
                bodies.push(Vec::new());
            } else if !line.is_empty()
                && !line.starts_with("===")
                && let Some(field) = field(line)?
                && let Some(body) = bodies.last_mut()
            {
                body.push(field);
            }
        }
        let index: HashMap<&str, usize> =
            names.iter().enumerate().rev().map(|(i, n)| (n.as_str(), i)).collect();
        let types = bodies
            .iter()
            .zip(&names)
            .map(|(body, owner)| body.iter().map(|raw| raw.resolve(owner, &index)).collect())
            .collect::<Result<_, _>>()?;
        Ok(Self { types })
    }
}

/// Name `package/Name`, also from `package/msg/Name`.
fn bare(name: &str) -> String {
    name.replace("/msg/", "/")
}

/// A field, or `None` for a constant.
fn field(line: &str) -> Result<Option<Raw<'_>>, String> {
    let (type_text, rest) =
        line.split_once(char::is_whitespace).ok_or_else(|| format!("its schema has the line '{line}'"))?;
    // TYPE NAME=VALUE is a constant; TYPE NAME VALUE has a default.
    let name = rest.split_whitespace().next().unwrap_or("");
    if rest
        .trim_start()
        .trim_start_matches(|c: char| c.is_alphanumeric() || c == '_')
        .trim_start()
        .starts_with('=')
    {
        return Ok(None);
    }
    let (type_name, count) = match type_text.split_once('[') {
        None => (type_text, Count::One),
        Some((type_name, size)) => {
            let size =
                size.strip_suffix(']').ok_or_else(|| format!("its schema has the type '{type_text}'"))?;
            let count = match size.parse() {
                Ok(n) => Count::Fixed(n),
                Err(_) if size.is_empty() || size.starts_with("<=") => Count::Sequence,
                Err(_) => return Err(format!("its schema has the type '{type_text}'")),
            };
            (type_name, count)
        }
    };
    // A bounded string such as string<=20 is a string.
    let type_name = type_name.split("<=").next().unwrap_or(type_name);
    Ok(Some(Raw { type_name, name, count }))
}

impl Raw<'_> {
    fn resolve(&self, owner: &str, index: &HashMap<&str, usize>) -> Result<Field, String> {
        let kind = match self.type_name {
            "bool" => Kind::Bool,
            "int8" => Kind::I8,
            "uint8" | "byte" | "char" => Kind::U8,
            "int16" => Kind::I16,
            "uint16" => Kind::U16,
            "int32" => Kind::I32,
            "uint32" => Kind::U32,
            "int64" => Kind::I64,
            "uint64" => Kind::U64,
            "float32" => Kind::F32,
            "float64" => Kind::F64,
            "string" => Kind::String,
            "time" => Kind::Time,
            "duration" => Kind::Duration,
            other => {
                let package = owner.split('/').next().unwrap_or("");
                let candidates = [bare(other), format!("{package}/{other}"), format!("std_msgs/{other}")];
                let found = candidates.iter().find_map(|name| index.get(name.as_str()));
                Kind::Message(*found.ok_or_else(|| format!("its schema does not define the type '{other}'"))?)
            }
        };
        Ok(Field { name: self.name.into(), kind, count: self.count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_with_their_types_are_understood() {
        let text = "\
# a comment
std_msgs/Header header
uint8 MODE_A=1
string NAME = \"a=b\"
float64[9] covariance   # row by row
Inner[<=3] parts
string<=10 label
int32 count 5
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: my_msgs/Inner
float32 x
";
        let d = Definition::parse("my_msgs/msg/Outer", text).unwrap();
        let names: Vec<_> = d.types[0].iter().map(|f| (f.name.as_str(), f.kind, f.count)).collect();
        assert_eq!(
            names,
            [
                ("header", Kind::Message(1), Count::One),
                ("covariance", Kind::F64, Count::Fixed(9)),
                ("parts", Kind::Message(3), Count::Sequence),
                ("label", Kind::String, Count::One),
                ("count", Kind::I32, Count::One),
            ]
        );
        assert_eq!(d.types[1][0].kind, Kind::Message(2));
    }

    #[test]
    fn what_is_not_understood_is_named() {
        assert!(Definition::parse("a/B", "Missing x").unwrap_err().contains("'Missing'"));
        assert!(Definition::parse("a/B", "float64").unwrap_err().contains("'float64'"));
        assert!(Definition::parse("a/B", "float64[x] y").unwrap_err().contains("float64[x]"));
        assert!(Definition::parse("a/B", "wstring y").unwrap_err().contains("'wstring'"));
    }
}
