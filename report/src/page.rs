//! A page: verdict, sections of plots and tables, facts; one self-contained HTML file.

use std::path::{Component, Path};

use minijinja::Environment;
use minijinja::value::Serde;
use serde::Serialize;
use serde_json::json;

use super::ReportError;
use super::packed::packed;
use super::plot::{Plot, plots_json};

/// Rating of a text or cell, shown as its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// The result is as wanted.
    Good,
    /// The result is not as wanted.
    Bad,
    /// The result deserves attention.
    Warn,
    /// No rating.
    #[default]
    Neutral,
}

/// A cell of a [`Table`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct Cell {
    /// Text.
    pub text: String,
    /// Rating, shown as the colour.
    pub level: Level,
    /// True for the best cell of a row.
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
    /// Text of the first column.
    pub label: String,
    /// True when the row is only a heading of the rows below it.
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
    /// Whether the cells are words instead of figures.
    pub words: bool,
}

/// How a line of a text changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// The line stayed.
    Same,
    /// The line is new.
    Added,
    /// The line was removed.
    Removed,
    /// Lines that stayed are left out here.
    Gap,
}

/// A line of a [`Section::diff`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DiffLine {
    /// How the line changed.
    pub change: Change,
    /// Text of the line.
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
    /// Changed lines of a text, below the tables.
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

/// The contents of a page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// Kind of page, shown above the title: "run report", "comparison".
    pub kind: String,
    /// Title.
    pub title: String,
    /// First line: the verdict in a sentence.
    pub verdict: String,
    /// Rating of the verdict, shown as its colour.
    pub level: Level,
    /// Further sentences worth reading.
    pub remarks: Vec<(Level, String)>,
    /// Sections of the page.
    pub sections: Vec<Section>,
    /// Facts: name and value.
    pub facts: Vec<(String, String)>,
    /// Files beside the page: text, and path relative to the page's folder.
    pub files: Vec<(String, String)>,
    /// Folded texts at the end.
    pub attachments: Vec<Attachment>,
}

/// Plotly.js as the build script prepared it: gzip in base64.
pub const PLOTLY: &str = include_str!(concat!(env!("OUT_DIR"), "/plotly.txt"));
const TEMPLATE: &str = include_str!("assets/page.html");
/// Style of the reports, in light and dark.
pub const STYLE: &str = include_str!("assets/page.css");
const SCRIPT: &str = include_str!("assets/page.js");

impl Page {
    /// The page as one HTML text that loads no other resource.
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
                    .map(|p| json!({ "id": p.id, "title": p.title, "height": p.height, "aside": p.aside, "caption": p.caption }))
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
            "files": self.files.iter().map(|(text, path)| (text, relative(path))).collect::<Vec<_>>(),
            "attachments": self.attachments,
            "style": STYLE,
            "script": SCRIPT,
            "plotly": PLOTLY,
            "data": packed(&plots_json(&plots)),
        })))?;
        Ok(html)
    }
}

/// A path as a relative URL that stays below the page's folder, whatever characters it contains.
fn relative(path: &str) -> String {
    let mut address = String::from(".");
    for part in Path::new(path).components() {
        if let Component::Normal(part) = part {
            address.push('/');
            for byte in part.to_string_lossy().bytes() {
                if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
                    address.push(byte as char);
                } else {
                    address.push_str(&format!("%{byte:02X}"));
                }
            }
        }
    }
    address
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;
    use flate2::read::GzDecoder;

    use super::*;
    use crate::plot::{Style, Trace};

    /// The original text of a packed text.
    fn unpacked(packed: &str) -> String {
        let bytes = STANDARD.decode(packed).unwrap();
        let mut text = String::new();
        GzDecoder::new(bytes.as_slice()).read_to_string(&mut text).unwrap();
        text
    }

    fn page(plots: Vec<Plot>) -> Page {
        Page {
            kind: "run report".into(),
            title: "a <b> & c".into(),
            verdict: "All is well.".into(),
            sections: vec![Section { title: "Outputs".into(), plots, ..Section::default() }],
            attachments: vec![Attachment { title: "launch file".into(), text: "x = \"<script>\"".into() }],
            ..Page::default()
        }
    }

    #[test]
    fn a_page_loads_nothing_and_escapes_what_it_is_told() {
        let mut plot = Plot::over_time("roll", "roll", "deg");
        plot.traces.push(Trace::new("truth", 0, Style::Main, &[0.0, 1.0], &[1.0, 2.0]));
        let html = page(vec![plot]).to_html().unwrap();
        assert_eq!(html.matches(PLOTLY).count(), 1, "Plotly is there once");
        for attribute in
            ["http:", "https:", "src=", "href=", "url(", "@import", "fetch(", "XMLHttpRequest", "<link"]
        {
            assert!(!html.contains(attribute), "{attribute}");
        }
        assert!(html.contains("default-src 'none'"), "the page forbids every request");
        assert!(html.contains("a &lt;b&gt; &amp; c") && !html.contains("\"<script>\""));
        assert!(html.contains("All is well.") && html.contains("id=\"plot-roll\""));
        let data = html.split("id=\"data\">").nth(1).unwrap().split('<').next().unwrap();
        assert!(unpacked(data).contains("\"truth\""), "{}", unpacked(data));
    }

    #[test]
    fn files_are_linked_and_stay_beside_the_page() {
        let files = ["log.mcap", "../../etc/passwd", "javascript:alert(1)", "/a \"b/c"];
        let files = files.map(|path| (path.to_string(), path.to_string())).to_vec();
        let html = Page { files, ..page(Vec::new()) }.to_html().unwrap();
        let links: Vec<&str> =
            html.split("href=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
        assert_eq!(links, ["./log.mcap", "./etc/passwd", "./javascript%3Aalert%281%29", "./a%20%22b/c"]);
    }

    #[test]
    fn text_and_tables_come_before_the_script() {
        let html = page(Vec::new()).to_html().unwrap();
        let script = html.find(PLOTLY).unwrap();
        assert!(html.find("All is well.").unwrap() < script && html.find("</main>").unwrap() < script);
    }

    #[test]
    fn the_script_draws_lines_and_brings_no_maps() {
        let script = unpacked(PLOTLY);
        for word in ["plotly.js v", "Licensed under the MIT license", "newPlot", "window.Plotly"] {
            assert!(script.contains(word), "{word}");
        }
        assert!(!script.contains("MathJax.loader") && !script.contains("maplibregl-map"));
        assert!(script.len() < 1_500_000, "{}", script.len());
    }

    #[test]
    fn the_fullest_page_is_less_than_2_mb() {
        // Noise compresses worst; a line with more points than a page may hold is thinned.
        let time: Vec<f64> = (0..20_000).map(|i| f64::from(i) * 5e-3).collect();
        let mut stream = whirlstand_vehicle::Stream::new(1, "page");
        let plots = (0..60).map(|i| {
            let noise: Vec<f64> = time.iter().map(|_| stream.normal()).collect();
            let mut plot = Plot::over_time(format!("p{i}"), "noise", "deg");
            plot.traces.push(Trace::new("noise", 0, Style::Main, &time, &noise));
            plot
        });
        let html = page(plots.collect()).to_html().unwrap();
        assert!(html.len() < 2_000_000, "{}", html.len());
    }
}
