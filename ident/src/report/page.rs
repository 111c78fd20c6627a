//! A page: verdict, sections of plots and tables, facts; one self-contained HTML file.

use std::sync::OnceLock;

use minijinja::Environment;
use minijinja::value::Serde;
use serde::Serialize;
use serde_json::json;

use super::ReportError;
use super::plot::{Plot, plots_json};

/// How good the news is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// As wanted.
    Good,
    /// Not as wanted.
    Bad,
    /// Worth a look.
    Warn,
    /// Neither.
    #[default]
    Neutral,
}

/// A cell of a [`Table`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct Cell {
    /// Text.
    pub text: String,
    /// Colour.
    pub level: Level,
    /// Best of its row.
    pub best: bool,
}

impl Cell {
    /// A cell without emphasis.
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// A cell with a level.
    pub fn leveled(text: impl Into<String>, level: Level) -> Self {
        Self { text: text.into(), level, best: false }
    }
}

/// A row of a [`Table`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct Row {
    /// First column.
    pub label: String,
    /// The row only groups those below it.
    pub group: bool,
    /// The other columns.
    pub cells: Vec<Cell>,
}

/// A table of figures.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct Table {
    /// Heads of all columns, the first one included.
    pub head: Vec<String>,
    /// Rows.
    pub rows: Vec<Row>,
    /// Small print under the table; may be empty.
    pub note: String,
}

/// What became of a line of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// It stayed.
    Same,
    /// It is new.
    Added,
    /// It is gone.
    Removed,
    /// Lines that stayed are left out here.
    Gap,
}

/// A line of a [`Section::diff`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DiffLine {
    /// What became of it.
    pub change: Change,
    /// Its text.
    pub text: String,
}

/// A part of the page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// A sentence or two under it; may be empty.
    pub text: String,
    /// Tables, above the plots.
    pub tables: Vec<Table>,
    /// Lines of a text that changed, below the tables.
    pub diff: Vec<DiffLine>,
    /// Plots.
    pub plots: Vec<Plot>,
    /// How many plots stand in a row where the page is wide enough; 0 counts as 1.
    pub columns: u8,
}

/// A text shown folded, such as a launch file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Attachment {
    /// Heading.
    pub title: String,
    /// Text.
    pub text: String,
}

/// What the page says.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// What kind of page, above the title: "run report", "comparison".
    pub kind: String,
    /// Title.
    pub title: String,
    /// First line: the verdict in a sentence.
    pub verdict: String,
    /// Its colour.
    pub level: Level,
    /// Further sentences worth reading.
    pub remarks: Vec<(Level, String)>,
    /// Parts.
    pub sections: Vec<Section>,
    /// Facts: what, value.
    pub facts: Vec<(String, String)>,
    /// Folded texts at the end.
    pub attachments: Vec<Attachment>,
}

/// Plotly.js, as the `plotly` crate carries it (MIT licence; the notice is in its first lines).
fn plotly_js() -> &'static str {
    static JS: OnceLock<String> = OnceLock::new();
    JS.get_or_init(|| {
        let elements = plotly::Plot::offline_js_sources();
        // Two script elements: Plotly and MathJax; no formula is drawn here, so the first one is enough.
        let start = elements.find('>').map_or(0, |i| i + 1);
        let end = elements.find("</script>").unwrap_or(elements.len());
        elements[start..end].to_string()
    })
}

const TEMPLATE: &str = include_str!("assets/page.html");
const STYLE: &str = include_str!("assets/page.css");
const SCRIPT: &str = include_str!("assets/page.js");

impl Page {
    /// The page as one HTML text that loads nothing from anywhere.
    ///
    /// # Errors
    /// [`ReportError`], which would be a bug.
    pub fn to_html(&self) -> Result<String, ReportError> {
        let mut environment = Environment::new();
        environment.add_template("page.html", TEMPLATE)?;
        let plots: Vec<Plot> = self.sections.iter().flat_map(|s| s.plots.iter().cloned()).collect();
        let sections: Vec<_> = self
            .sections
            .iter()
            .map(|s| {
                let plots: Vec<_> = s
                    .plots
                    .iter()
                    .map(|p| json!({ "id": p.id, "title": p.title, "height": p.height, "y": p.y_label, "caption": p.caption }))
                    .collect();
                json!({
                    "title": s.title, "text": s.text, "tables": s.tables, "diff": s.diff, "plots": plots,
                    "columns": s.columns,
                })
            })
            .collect();
        let html = environment.get_template("page.html")?.render(Serde(json!({
            "kind": self.kind,
            "title": self.title,
            "verdict": self.verdict,
            "level": self.level,
            "remarks": self.remarks,
            "sections": sections,
            "facts": self.facts,
            "attachments": self.attachments,
            "style": STYLE,
            "script": SCRIPT,
            "plotly": plotly_js(),
            "data": plots_json(&plots),
        })))?;
        Ok(html)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::report::plot::{Look, Trace};

    /// The page without the text of Plotly, after checking that it asks for nothing from outside.
    pub(crate) fn own_part(html: &str) -> String {
        assert_eq!(html.matches(plotly_js()).count(), 1, "Plotly is there once");
        let own = html.replace(plotly_js(), "");
        for attribute in ["src=", "href=", "url(", "@import", "fetch(", "XMLHttpRequest", "<link"] {
            assert!(!own.contains(attribute), "{attribute}");
        }
        assert!(own.contains("default-src 'none'"), "the page forbids every request");
        own
    }

    #[test]
    fn a_page_is_self_contained_and_escapes_what_it_is_told() {
        let mut plot = Plot::over_time("roll", "roll", "deg");
        plot.traces.push(Trace::new("truth", 0, Look::Main, &[0.0, 1.0], &[1.0, 2.0]));
        let page = Page {
            kind: "run report".into(),
            title: "a <b> & c".into(),
            verdict: "All is well.".into(),
            sections: vec![Section { title: "Outputs".into(), plots: vec![plot], ..Section::default() }],
            attachments: vec![Attachment { title: "launch file".into(), text: "x = \"<script>\"".into() }],
            ..Page::default()
        };
        let html = page.to_html().unwrap();
        let own = own_part(&html);
        assert!(own.contains("a &lt;b&gt; &amp; c") && !own.contains("\"<script>\""));
        assert!(own.contains("All is well.") && own.contains("id=\"plot-roll\""));
        assert!(html.len() < 5_500_000, "{}", html.len());
        assert!(plotly_js().contains("plotly.js v") && !plotly_js().contains("MathJax.loader"));
    }
}
