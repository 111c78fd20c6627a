//! The live page as seen by a program: requests written by hand, and the received frames.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;

use serde_json::Value;

use super::{FAULTS_ALLOWED, HUNG, Running, spawn, whirlstand};

/// Settings that open a bench to controls.
pub const OPEN: [&str; 4] = ["--set", "plant.inject=true", "--set", "controller.pilot=true"];

/// Address of the page that a command has printed.
#[track_caller]
pub fn page_of(command: &mut Running) -> String {
    let line = command.wait_for_stderr("live page http");
    let url = line.split_whitespace().find(|word| word.starts_with("http")).expect("an address");
    url.to_string()
}

/// A quadrotor's bench that is open to controls and flies for a long time, with its files below `out`, and the
/// address of its page.
#[track_caller]
pub fn live_bench(name: &str, out: &Path) -> (Running, String) {
    let out = out.to_str().expect("utf-8 path");
    let args = ["run", "quadrotor", "--bench", name, "--live", "0", "--duration", "1 h", "--out", out];
    let more = ["--set", FAULTS_ALLOWED];
    let mut bench = spawn(whirlstand(args.into_iter().chain(OPEN).chain(more)));
    let url = page_of(&mut bench);
    (bench, url)
}

/// Sends a request written by hand; the reader is positioned before the answer.
#[track_caller]
pub fn request(url: &str, lines: &str, host: Option<&str>) -> BufReader<TcpStream> {
    let (authority, path) = url.trim_start_matches("http://").split_once('/').expect("a path");
    let mut stream = TcpStream::connect(authority).unwrap_or_else(|e| panic!("{url}: {e}"));
    stream.set_read_timeout(Some(HUNG)).unwrap();
    let (method, rest) = lines.split_once(' ').unwrap_or((lines, ""));
    let host = host.unwrap_or(authority);
    let end = if rest.is_empty() { "\r\n" } else { "" };
    let head = format!("{method} /{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{rest}{end}");
    stream.write_all(head.as_bytes()).unwrap();
    BufReader::new(stream)
}

#[track_caller]
pub fn status(reader: &mut BufReader<TcpStream>) -> String {
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    line.split_whitespace().nth(1).unwrap_or_default().into()
}

/// Requests a change as the page does. Returns status and text of the answer.
#[track_caller]
pub fn control(url: &str, body: &str) -> (String, String) {
    let head = format!("POST Content-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}", body.len());
    let mut reader = request(&format!("{url}control"), &head, None);
    let (code, mut text) = (status(&mut reader), String::new());
    reader.read_to_string(&mut text).unwrap();
    (code, text)
}

/// Address of the frames, from that of the page.
pub fn frames_of(url: &str) -> String {
    let (base, query) = url.split_once('?').map_or((url, String::new()), |(b, q)| (b, format!("?{q}")));
    format!("{base}events{query}")
}

/// Reads frames until one satisfies `wanted`.
#[track_caller]
pub fn read_until(reader: &mut BufReader<TcpStream>, wanted: impl Fn(&Value) -> bool) -> Value {
    let mut line = String::new();
    while reader.read_line(&mut line).unwrap() > 0 {
        if let Some(text) = line.trim_end().strip_prefix("data: ") {
            let frame: Value = serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"));
            if wanted(&frame) {
                return frame;
            }
        }
        line.clear();
    }
    panic!("the frames ended before one was as wanted");
}
