//! The header of a log: the fields of its frames, how they are stored, and the settings needed to interpret the
//! numbers.

use std::collections::HashMap;

use super::encoding::Encoding;

/// Most fields of a frame; a limit that keeps a damaged header from requesting more memory.
const MOST_FIELDS: usize = 128;

/// Longer than any line of a header, bytes.
const LONGEST_LINE: usize = 8192;

/// Version of the format that can be read; all logs since 2015 have it.
const VERSION: &str = "2";

/// Prediction from which a stored number is the difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Predictor {
    /// A constant.
    Constant(i64),
    /// The number in the frame before.
    Previous,
    /// Linear extrapolation of the two frames before.
    StraightLine,
    /// Mean of the two frames before.
    Mean,
    /// The number in the frame before, plus one.
    Increment,
    /// Another field of the same frame.
    Field(usize),
    /// A coordinate of the home position.
    Home(usize),
    /// Time of the last main frame.
    MainTime,
}

/// Fields of one kind of frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Frame {
    /// Their names.
    pub names: Vec<String>,
    /// Whether they are signed.
    pub signed: Vec<bool>,
    /// Storage of the fields in a self-contained frame.
    pub whole: Storage,
    /// Storage of the fields in a frame of differences.
    pub difference: Storage,
}

/// How the fields of a frame are stored.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Storage {
    /// Predictor of each field.
    pub predictors: Vec<Predictor>,
    /// Groups of consecutive fields: encoding and number of fields.
    pub groups: Vec<(Encoding, usize)>,
}

/// The header of a log.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    /// Frames of every logged iteration.
    pub main: Frame,
    /// Index of the time field in the main frames.
    pub time: usize,
    /// Frames of rarely changing data.
    pub slow: Frame,
    /// Frames of the satellite receiver.
    pub gps: Frame,
    /// Frames of the home position.
    pub home: Frame,
    /// All header lines by name.
    lines: HashMap<String, String>,
    /// Offset at which the frames begin.
    pub end: usize,
}

impl Header {
    /// Reads the header at the beginning of a log.
    ///
    /// # Errors
    /// What is wrong with it, as the end of a sentence.
    pub fn parse(data: &[u8]) -> Result<Self, String> {
        let (lines, end) = lines(data);
        match lines.get("Data version").map(String::as_str) {
            Some(VERSION) => {}
            Some(other) => {
                return Err(format!("its format version is {other}, but only {VERSION} is supported"));
            }
            None => return Err("its header does not state the version of the format".into()),
        }
        let main = frame(&lines, "I", "P")?;
        let Some(time) = main.names.iter().position(|name| name == "time") else {
            return Err("its main frames have no time".into());
        };
        let optional = |kind| {
            if lines.contains_key(&key(kind, "name")) {
                frame(&lines, kind, kind)
            } else {
                Ok(Frame::default())
            }
        };
        Ok(Self { time, slow: optional("S")?, gps: optional("G")?, home: optional("H")?, main, end, lines })
    }

    /// The text of a header line.
    pub fn line(&self, name: &str) -> Option<&str> {
        self.lines.get(name).map(String::as_str)
    }

    /// A number in the header.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.line(name)?.trim().parse().ok().filter(|number: &f64| number.is_finite())
    }
}

/// The lines `H name:value`, and the offset of their end. A damaged line that is still text is skipped.
fn lines(data: &[u8]) -> (HashMap<String, String>, usize) {
    let mut lines = HashMap::new();
    let mut at = 0;
    while let Some(rest) = data.get(at..).filter(|rest| !rest.is_empty()) {
        let Some(length) = rest.iter().take(LONGEST_LINE).position(|b| *b == b'\n') else { break };
        let text =
            std::str::from_utf8(&rest[..length]).ok().filter(|text| !text.contains(|c: char| c.is_control()));
        let line = text.and_then(|text| text.strip_prefix("H ")?.split_once(':'));
        if let Some((name, value)) = line {
            lines.insert(name.to_string(), value.to_string());
        } else if !rest[length + 1..].starts_with(b"H ") {
            break;
        }
        at += length + 1;
    }
    (lines, at)
}

fn key(kind: &str, property: &str) -> String {
    format!("Field {kind} {property}")
}

/// The fields of the frames `whole`, and their storage in these and in the frames `difference`.
fn frame(lines: &HashMap<String, String>, whole: &str, difference: &str) -> Result<Frame, String> {
    let list = |kind: &str, property: &str| {
        let key = key(kind, property);
        let line = lines.get(&key).ok_or_else(|| format!("its header has no line '{key}'"))?;
        Ok::<Vec<&str>, String>(line.split(',').map(str::trim).collect())
    };
    let names: Vec<String> = list(whole, "name")?.into_iter().map(String::from).collect();
    if names.len() > MOST_FIELDS {
        return Err(format!(
            "its header has {} fields in '{}', but at most {MOST_FIELDS} are supported",
            names.len(),
            key(whole, "name")
        ));
    }
    let same = |kind: &str, property: &str| {
        let list = list(kind, property)?;
        if list.len() == names.len() {
            return Ok(list);
        }
        Err(format!("its header has {} fields but {} in '{}'", names.len(), list.len(), key(kind, property)))
    };
    let storage = |kind: &str| {
        let predictors = predictors(lines, &names, &same(kind, "predictor")?)
            .map_err(|reason| format!("'{}' of its header: {reason}", key(kind, "predictor")))?;
        let groups = groups(&same(kind, "encoding")?)
            .map_err(|reason| format!("'{}' of its header: {reason}", key(kind, "encoding")))?;
        Ok::<Storage, String>(Storage { predictors, groups })
    };
    let signed = same(whole, "signed")?.into_iter().map(|sign| sign != "0").collect();
    let (whole, difference) = (storage(whole)?, storage(difference)?);
    Ok(Frame { signed, whole, difference, names })
}

fn predictors(
    lines: &HashMap<String, String>,
    names: &[String],
    numbers: &[&str],
) -> Result<Vec<Predictor>, String> {
    let setting = |name: &str| {
        let first = lines.get(name).and_then(|value| value.split(',').next());
        let value = first.and_then(|value| value.trim().parse::<i32>().ok());
        value
            .map(|value| Predictor::Constant(value.into()))
            .ok_or_else(|| format!("it refers to '{name}', which the header does not have"))
    };
    let motor = names.iter().position(|name| name == "motor[0]");
    let mut homes = 0;
    let predictor = |(at, number): (usize, &&str)| {
        Ok(match *number {
            "0" => Predictor::Constant(0),
            "1" => Predictor::Previous,
            "2" => Predictor::StraightLine,
            "3" => Predictor::Mean,
            "4" => setting("minthrottle")?,
            "5" => match motor {
                Some(motor) if motor < at => Predictor::Field(motor),
                _ => return Err("it refers to motor[0], which does not precede it".into()),
            },
            "6" => Predictor::Increment,
            "7" => {
                homes += 1;
                // Latitude and longitude alternate.
                Predictor::Home((homes - 1) % 2)
            }
            "8" => Predictor::Constant(1500),
            "9" => setting("vbatref")?,
            "10" => Predictor::MainTime,
            "11" => setting("motorOutput")?,
            other => return Err(format!("'{other}' is not a known number")),
        })
    };
    numbers.iter().enumerate().map(predictor).collect()
}

fn groups(numbers: &[&str]) -> Result<Vec<(Encoding, usize)>, String> {
    let parsed =
        numbers.iter().map(|n| Encoding::parse(n).ok_or_else(|| format!("'{n}' is not a known number")));
    let encodings = parsed.collect::<Result<Vec<_>, _>>()?;
    let mut groups = Vec::new();
    let mut at = 0;
    while let Some(encoding) = encodings.get(at) {
        let alike = encodings[at..].iter().take_while(|e| *e == encoding).count();
        let count = encoding.group(alike, encodings.len() - at);
        groups.push((*encoding, count));
        at += count;
    }
    Ok(groups)
}
