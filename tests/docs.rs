//! The commands in README.md and docs/ run as written and print the output shown below them; all links are valid.
//!
//! A block of commands is run in the folder of the blocks before it in the same file. If a block of output follows,
//! each of its lines must have been printed, with any number in place of a number; `...` stands for omitted lines. A
//! block after `<!-- not run: REASON -->` is skipped, for the reason stated there.

use std::path::{Component, Path, PathBuf};
use std::process::Command;

use crate::support::spawn;
use whirlstand_test_harness::Test;

/// A block between fences.
#[derive(Debug, PartialEq)]
struct Block {
    line: usize,
    language: String,
    text: String,
    not_run: bool,
}

fn blocks(text: &str) -> Vec<Block> {
    let (mut blocks, mut open, mut not_run) = (Vec::new(), None::<Block>, false);
    for (i, line) in text.lines().enumerate() {
        match (&mut open, line.strip_prefix("```")) {
            (None, Some(language)) => {
                open = Some(Block { line: i + 1, language: language.into(), text: String::new(), not_run });
            }
            (Some(_), Some("")) => blocks.extend(open.take()),
            (Some(block), _) => block.text.push_str(&format!("{line}\n")),
            (None, None) if line.trim().is_empty() => {}
            (None, None) => not_run = line.starts_with("<!-- not run: "),
        }
    }
    assert_eq!(open, None, "a block has no end");
    blocks
}

/// A line in which a mark replaces every number and every run of spaces.
fn shape(line: &str) -> String {
    let mut shape = String::new();
    let mut chars = line.trim().chars().peekable();
    while let Some(c) = chars.next() {
        let signed = "+-".contains(c) && chars.peek().is_some_and(char::is_ascii_digit);
        if c.is_ascii_digit() || signed {
            while chars.peek().is_some_and(|c| c.is_ascii_alphanumeric() || ".-+".contains(*c)) {
                chars.next();
            }
            shape.push('#');
        } else if c.is_whitespace() {
            while chars.peek().is_some_and(|c| c.is_whitespace()) {
                chars.next();
            }
            shape.push(' ');
        } else {
            shape.push(c);
        }
    }
    shape
}

/// Runs the commands of a file.
fn commands(file: &Path) {
    let text = std::fs::read_to_string(file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_whirlstand")).parent().unwrap();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::iter::once(program.to_path_buf()).chain(std::env::split_paths(&path));
    let path = std::env::join_paths(path).unwrap();
    let blocks = blocks(&text);
    for (i, block) in blocks.iter().enumerate().filter(|(_, b)| b.language == "sh" && !b.not_run) {
        let place = format!("{}:{}", file.display(), block.line);
        let mut shell = Command::new("bash");
        shell.args(["-euo", "pipefail", "-c", &block.text]).current_dir(folder.path()).env("PATH", &path);
        let ended = spawn(shell).finish();
        assert_eq!(ended.code(), 0, "{place}\n{}\n{}", ended.stdout, ended.stderr);
        let printed: Vec<String> = ended.stdout.lines().chain(ended.stderr.lines()).map(shape).collect();
        let Some(wanted) = blocks.get(i + 1).filter(|b| b.language == "text") else { continue };
        for line in wanted.text.lines().filter(|l| !l.trim().is_empty() && l.trim() != "...") {
            assert!(
                printed.contains(&shape(line)),
                "{place} says that it prints\n{line}\nbut it prints\n{}\n{}",
                ended.stdout,
                ended.stderr
            );
        }
    }
}

fn here() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// README.md and the files of docs/.
fn files() -> Vec<PathBuf> {
    let docs = std::fs::read_dir(here().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = docs.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    files.push(here().join("README.md"));
    files.sort();
    files
}

/// Every link to a file has a target, and no link leaves docs/, because the book contains nothing else; every link to a
/// heading has that heading; the book lists every file once.
fn links_lead_somewhere() {
    let summary = std::fs::read_to_string(here().join("docs/SUMMARY.md")).unwrap();
    for file in files() {
        let text = std::fs::read_to_string(&file).unwrap();
        let in_docs = file.parent().unwrap().ends_with("docs");
        for (i, target) in
            text.split("](").enumerate().skip(1).map(|(i, rest)| (i, rest.split(')').next().unwrap()))
        {
            if target.contains("://") || target.contains(char::is_whitespace) {
                continue;
            }
            let (path, heading) = target.split_once('#').unwrap_or((target, ""));
            let there = if path.is_empty() { file.clone() } else { file.parent().unwrap().join(path) };
            assert!(there.exists(), "{}, link {i}: {target} leads nowhere", file.display());
            let leaves = in_docs && Path::new(path).components().any(|part| part == Component::ParentDir);
            assert!(!leaves, "{}, link {i}: {target} is not in the book", file.display());
            if !heading.is_empty() {
                let page = std::fs::read_to_string(&there).unwrap();
                let known = headings(&page).into_iter().any(|h| anchor(h) == heading);
                assert!(known, "{}, link {i}: {target} names no heading", file.display());
            }
        }
        let name = file.file_name().unwrap().to_string_lossy();
        if in_docs && name != "SUMMARY.md" {
            let times = summary.matches(&format!("({name})")).count();
            assert_eq!(times, 1, "docs/SUMMARY.md has {name} so many times");
        }
    }
}

/// The headings of a page. A comment in a block of commands is not a heading.
fn headings(text: &str) -> Vec<&str> {
    let mut in_block = false;
    let mut is_heading = |line: &&str| {
        in_block ^= line.starts_with("```");
        !in_block && line.starts_with('#')
    };
    text.lines().filter(|line| is_heading(line)).collect()
}

/// The anchor of a heading.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    text.chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

fn numbers_may_differ_and_words_may_not() {
    assert_eq!(shape("  pitch  by 21.7 deg, -3.1e-4"), shape("pitch by 9.9 deg, 12"));
    assert_eq!(shape("out/quadrotor-2026-11-21/log.mcap"), shape("out/quadrotor-1/log.mcap"));
    assert_ne!(shape("completed"), shape("failed"));
    let found = blocks("a\n<!-- not run: no hardware -->\n\n```sh\nfly\n```\nb\n```text\nc\n```\n");
    assert_eq!((found[0].not_run, found[0].text.as_str(), found[0].line), (true, "fly\n", 4));
    assert_eq!((found[1].not_run, found[1].language.as_str()), (false, "text"));
}

fn comments_are_no_headings() {
    assert_eq!(headings("# A\n```sh\n# b\n```\n## C d\ntext\n"), ["# A", "## C d"]);
    assert_eq!(anchor("## C d, `e`"), "c-d-e");
}

/// These tests, one for each page among them.
pub fn tests() -> Vec<Test> {
    let mut tests = vec![
        Test::new("links_lead_somewhere", links_lead_somewhere),
        Test::new("comments_are_no_headings", comments_are_no_headings),
        Test::new("numbers_may_differ_and_words_may_not", numbers_may_differ_and_words_may_not),
    ];
    for file in files() {
        let name = format!("commands_of_{}", file.file_stem().unwrap().to_string_lossy());
        tests.push(Test::new(&name.replace('-', "_"), move || commands(&file)));
    }
    tests
}
