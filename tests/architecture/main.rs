//! The rules of the rooms: which may know which, and that the arrows between the files of one make no circle.

mod source_graph;

use std::path::{Path, PathBuf};

use source_graph::SourceGraph;

/// Each room, and the rooms that it may depend on besides for its tests. `launch` ties all of them together.
const ROOMS: [(&str, &[&str]); 18] = [
    ("msgs", &[]),
    ("bus", &["msgs"]),
    ("linalg", &[]),
    ("vehicle", &["linalg", "msgs"]),
    ("control", &["linalg", "vehicle"]),
    ("logs", &["linalg", "msgs"]),
    ("ident", &["control", "linalg", "logs", "msgs", "vehicle"]),
    ("diagnose", &["ident", "linalg", "logs", "vehicle"]),
    ("blind", &["vehicle"]),
    ("evaluate", &["linalg", "logs", "msgs", "vehicle"]),
    ("campaign", &[]),
    ("report", &["campaign", "control", "diagnose", "evaluate", "ident", "logs", "msgs"]),
    ("live", &["bus", "logs", "msgs", "report", "vehicle"]),
    ("mirror", &["control", "vehicle"]),
    ("bridge", &["msgs", "vehicle"]),
    ("nodes", &["bridge", "bus", "control", "diagnose", "logs", "mirror", "msgs", "vehicle"]),
    ("fmu", &["msgs", "vehicle"]),
    (
        "launch",
        &[
            "blind", "bridge", "bus", "campaign", "control", "diagnose", "evaluate", "fmu", "ident", "live",
            "logs", "mirror", "msgs", "nodes", "report", "vehicle",
        ],
    ),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).into()
}

/// The rooms that a room's own code depends on, by its manifest.
fn dependencies(room: &str) -> Vec<String> {
    let path = root().join(room).join("Cargo.toml");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let manifest: toml::Table = text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let table = manifest.get("dependencies").and_then(toml::Value::as_table);
    let names = table.into_iter().flat_map(|t| t.keys());
    names.filter_map(|name| name.strip_prefix("whirlstand-")).map(String::from).collect()
}

#[test]
fn rooms_know_only_the_rooms_below() {
    for (n, (room, allowed)) in ROOMS.iter().enumerate() {
        for known in dependencies(room) {
            assert!(allowed.contains(&known.as_str()), "{room} may not depend on {known}");
            let at = ROOMS.iter().position(|(name, _)| **name == known);
            assert!(at.is_some_and(|at| at < n), "{known} is not below {room}");
        }
    }
}

#[test]
fn every_crate_of_the_workspace_has_its_rule() {
    let text = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let manifest: toml::Table = text.parse().unwrap();
    let members = manifest["workspace"]["members"].as_array().unwrap().iter().map(|m| m.as_str().unwrap());
    let rooms: Vec<&str> = members.filter(|member| *member != "tests/harness").collect();
    let mut ruled = ROOMS.map(|(room, _)| room).to_vec();
    ruled.sort_unstable();
    let mut sorted = rooms.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, ruled);
}

#[test]
fn arrows_between_the_files_of_a_room_make_no_circle() {
    let mut wrong = Vec::new();
    for (room, _) in ROOMS {
        let circles = SourceGraph::read(&root().join(room).join("src/lib.rs")).circles();
        let arrows: Vec<String> = circles.iter().map(|circle| circle.join("\n  ")).collect();
        if !arrows.is_empty() {
            wrong.push(format!("{room}: {} circles\n  {}", arrows.len(), arrows.join("\n\n  ")));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n").replace(&format!("{}/", root().display()), ""));
}

/// The circles of a crate with these files.
fn circles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    let circles = SourceGraph::read(&dir.path().join("lib.rs")).circles();
    let root = format!("{}/", dir.path().display());
    circles.into_iter().map(|circle| circle.iter().map(|arrow| arrow.replace(&root, "")).collect()).collect()
}

#[test]
fn a_circle_through_uses_paths_and_macros_is_found() {
    let found = circles_of(&[
        ("lib.rs", "mod a; mod b; mod c;"),
        ("a.rs", "use crate::b::B; pub struct A(B);"),
        ("b.rs", "pub struct B; fn f() { super::c::g(); }"),
        ("c.rs", "pub fn g() { println!(\"{}\", size_of::<crate::a::A>()); }"),
    ]);
    assert_eq!(found, [["a.rs -> b.rs: B", "b.rs -> c.rs: g", "c.rs -> a.rs: A"]]);
}

#[test]
fn a_re_export_forwards_to_the_file_that_defines_the_name() {
    let shared = ("m/mod.rs", "mod x; mod y; pub use x::X; pub(crate) use y::*;");
    let down = [
        ("lib.rs", "mod m;"),
        shared,
        ("m/x.rs", "pub struct X;"),
        ("m/y.rs", "use super::X; pub fn y(_: X) {}"),
    ];
    assert_eq!(circles_of(&down), Vec::<Vec<String>>::new());
    let round = [("lib.rs", "mod m;"), shared, ("m/x.rs", "pub struct X; fn f() { super::y(X) }"), down[3]];
    assert_eq!(circles_of(&round), [["m/x.rs -> m/y.rs: y", "m/y.rs -> m/x.rs: X"]]);
}

#[test]
fn tests_and_variables_are_no_arrows() {
    let files = [
        ("lib.rs", "mod a; mod b;"),
        ("a.rs", "use crate::b::B; pub fn run(b: B) {} #[cfg(test)] mod tests { use super::*; }"),
        (
            "b.rs",
            "pub struct B; fn f() { let a = 1; drop(a); } #[cfg(test)] mod tests { use crate::a::run; }",
        ),
    ];
    assert_eq!(circles_of(&files), Vec::<Vec<String>>::new());
}
