//! Differences of two versions of a text.

use similar::{ChangeTag, TextDiff};

use super::page::{Change, DiffLine};

/// Unchanged lines that are shown around changed ones.
const CONTEXT: usize = 3;

/// The lines that changed from one text to the other, with unchanged neighbours.
pub fn changed_lines(before: &str, after: &str) -> Vec<DiffLine> {
    let diff = TextDiff::from_lines(before, after);
    let line = |change: Change, text: &str| DiffLine { change, text: text.trim_end().to_string() };
    let mut lines = Vec::new();
    for (group, ops) in diff.grouped_ops(CONTEXT).iter().enumerate() {
        if group > 0 {
            lines.push(line(Change::Gap, "..."));
        }
        for change in ops.iter().flat_map(|op| diff.iter_changes(op)) {
            let kind = match change.tag() {
                ChangeTag::Equal => Change::Same,
                ChangeTag::Insert => Change::Added,
                ChangeTag::Delete => Change::Removed,
            };
            lines.push(line(kind, change.value()));
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_added_shows_with_its_neighbours_only() {
        let before: String = (0..30).map(|i| format!("line {i}\n")).collect();
        let after = before.replace("line 20\n", "line 20\nnew\n").replace("line 3\n", "");
        let lines = changed_lines(&before, &after);
        let count = |change: Change| lines.iter().filter(|l| l.change == change).count();
        assert_eq!((count(Change::Added), count(Change::Removed), count(Change::Gap)), (1, 1, 1));
        assert!(lines.iter().any(|l| l.change == Change::Added && l.text == "new"));
        assert!(lines.iter().any(|l| l.change == Change::Removed && l.text == "line 3"));
        assert!(lines.len() < 20 && changed_lines(&before, &before).is_empty());
    }
}
