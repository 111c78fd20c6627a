//! Plots as data. `assets/page.js` gives them to Plotly in the colours of the page.

use serde::Serialize;

use whirlstand_logs::decimate;
use whirlstand_logs::shown::number;

/// How a trace is drawn. The page maps it to colour, width and dash, for light and for dark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Style {
    /// The main line of a variant.
    Main,
    /// A second line beside the main one, dashed.
    Second,
    /// An estimate of another line, in a colour of its own.
    Estimate,
    /// Measurements of a sensor, thin and pale.
    Sensor,
    /// A reference value, neutral and in steps.
    Wanted,
    /// A limit or bound: neutral, dotted.
    Limit,
    /// A value held from point to point, such as a command.
    Held,
    /// The outline of a histogram, filled: the height of a bucket at its lower edge.
    Histogram,
    /// Single points.
    Points,
    /// Single points as crosses, such as poles.
    Crosses,
    /// Many single points, pale.
    Cloud,
}

/// One line of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Text of the legend, which shows lines of one name as one.
    pub name: String,
    /// Number of the variant, which chooses the colour.
    pub variant: usize,
    /// Style of the line.
    pub style: Style,
    /// True for a line that is drawn only after a click on the legend.
    pub hidden: bool,
    /// Abscissae, in the unit of the x axis.
    pub x: Vec<f64>,
    /// Ordinates, in the unit of the plot; NaN is a gap.
    pub y: Vec<f64>,
}

impl Trace {
    /// A visible line.
    pub fn new(name: impl Into<String>, variant: usize, style: Style, x: &[f64], y: &[f64]) -> Self {
        Self { name: name.into(), variant, style, hidden: false, x: x.to_vec(), y: y.to_vec() }
    }

    /// The trace, hidden until the legend is clicked if `hidden`.
    pub fn hide_if(mut self, hidden: bool) -> Self {
        self.hidden = hidden;
        self
    }
}

/// Meaning of a shaded span.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SpanKind {
    /// A disturbance acts.
    Disturbance,
    /// Commands were late, and the last one was held.
    Held,
    /// The plant was in failsafe.
    Failsafe,
    /// The part of the record with the greatest error.
    Worst,
    /// The held-out part of the record.
    HeldOut,
}

/// A shaded part of the x axis; with equal ends it is a line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Span {
    /// Start on the x axis.
    pub from: f64,
    /// End on the x axis.
    pub until: f64,
    /// Meaning of the span, which the legend shows.
    pub kind: SpanKind,
}

/// Values over a plane, shown as colours, with equal steps along both axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Heat {
    /// Middles of the columns, in the unit of the x axis.
    pub x: Vec<f64>,
    /// Middles of the rows, in the unit of the y axis.
    pub y: Vec<f64>,
    /// Row by row, a value each column; NaN is a gap.
    pub z: Vec<Vec<f64>>,
    /// Unit of the values.
    pub unit: String,
}

/// A plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Identifier, unique in the page.
    pub id: String,
    /// Heading.
    pub title: String,
    /// Text beside the heading, with less weight; may be empty.
    pub aside: String,
    /// Label of the x axis, with its unit after the last comma.
    pub x_label: String,
    /// Label of the y axis: its unit, or a text with the unit after the last comma.
    pub y_label: String,
    /// Plots of one group zoom together.
    pub group: Option<&'static str>,
    /// Logarithmic x axis.
    pub log_x: bool,
    /// Logarithmic y axis.
    pub log_y: bool,
    /// Ends of the y axis; `None` derives them from the lines.
    pub y_range: Option<(f64, f64)>,
    /// Lines.
    pub traces: Vec<Trace>,
    /// Colours under the lines.
    pub heat: Option<Heat>,
    /// Both axes have the same scale, as for poles in the plane.
    pub square: bool,
    /// Shaded parts.
    pub spans: Vec<Span>,
    /// Texts at points, `(x, y, text)`.
    pub notes: Vec<(f64, f64, String)>,
    /// A sentence under the heading; may be empty.
    pub caption: String,
    /// Height on the page, px.
    pub height: u32,
}

impl Plot {
    /// A plot over time, which zooms together with the other plots over time.
    pub fn over_time(id: impl Into<String>, title: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self { group: Some("time"), x_label: "time, s".into(), ..Self::new(id, title, "", y_label) }
    }

    /// A plot with its own x axis.
    pub fn new(
        id: impl Into<String>,
        title: impl Into<String>,
        x_label: impl Into<String>,
        y_label: impl Into<String>,
    ) -> Self {
        Self {
            id: id.into(),
            title: title.into(),
            aside: String::new(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            group: None,
            log_x: false,
            log_y: false,
            y_range: None,
            traces: Vec::new(),
            heat: None,
            square: false,
            spans: Vec::new(),
            notes: Vec::new(),
            caption: String::new(),
            height: 280,
        }
    }

    /// Keeps `transient` lines from flattening the rest of a plot by their values in the first twentieth of the x
    /// axis. Where these values would more than double the y axis, the axis is scaled to the rest, and the caption
    /// states what is outside.
    pub fn leave_out_start(&mut self, transient: impl Fn(&Trace) -> bool) {
        let ends = extent(self.traces.iter().flat_map(|t| t.x.iter().copied()));
        let from = ends.0 + 0.05 * (ends.1 - ends.0);
        let shown = || self.traces.iter().filter(|t| !t.hidden);
        let all = extent(shown().flat_map(|t| t.y.iter().copied()));
        let settled = extent(shown().flat_map(|t| {
            let all = !transient(t);
            t.x.iter().zip(&t.y).filter(move |(x, _)| all || **x >= from).map(|(_, y)| *y)
        }));
        let (wide, narrow) = (all.1 - all.0, settled.1 - settled.0);
        if narrow > 0.0 && wide > 2.0 * narrow {
            self.y_range = Some((settled.0 - 0.06 * narrow, settled.1 + 0.06 * narrow));
            let far = if all.1.abs() > all.0.abs() { all.1 } else { all.0 };
            let unit = if self.y_label.is_empty() { String::new() } else { format!(" {}", self.y_label) };
            self.caption = format!(
                "The start, up to {}{unit}, is outside the axis range: double-click to see it.",
                number(far)
            );
        }
    }
}

/// Least and greatest finite value.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// Most numbers in all plots of a page together; each takes about 8 characters in the file.
const PAGE_BUDGET: usize = 360_000;
/// Most points of a line: a plot is rarely wider than this many pixels divided by four, and four points fill
/// one pixel.
const MOST_POINTS: usize = 6_000;

/// All plots of a page as one JSON text. Equal columns, such as a time axis that lines share, are written
/// once. Every line is thinned so that the total stays within [`PAGE_BUDGET`].
pub fn plots_json(plots: &[Plot]) -> String {
    let long = plots.iter().flat_map(|p| &p.traces).count().max(1);
    let most = (PAGE_BUDGET / (2 * long)).clamp(400, MOST_POINTS);
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let mut column = |values: Vec<f64>| -> usize {
        let same = |c: &Vec<f64>| c.len() == values.len() && c.iter().zip(&values).all(|(a, b)| a == b);
        columns.iter().position(same).unwrap_or_else(|| {
            columns.push(values);
            columns.len() - 1
        })
    };
    let plots: Vec<serde_json::Value> = plots
        .iter()
        .map(|p| {
            let traces: Vec<_> = p
                .traces
                .iter()
                .map(|trace| {
                    let (x, y) = decimate(&trace.x, &trace.y, most);
                    serde_json::json!({
                        "name": trace.name, "variant": trace.variant, "look": trace.style, "hidden": trace.hidden,
                        "x": column(rounded(&x)), "y": column(rounded(&y)),
                    })
                })
                .collect();
            serde_json::json!({
                "id": p.id, "title": p.title, "x": p.x_label, "y": p.y_label, "group": p.group,
                "log_x": p.log_x, "log_y": p.log_y, "y_range": p.y_range, "height": p.height,
                "traces": traces, "spans": p.spans, "notes": p.notes, "square": p.square,
                "heat": p.heat.as_ref().map(|h| serde_json::json!({
                    "x": column(rounded(&h.x)), "y": column(rounded(&h.y)), "z": tenths(&h.z), "unit": h.unit,
                })),
            })
        })
        .collect();
    // The text is put into a page unchanged, so it must contain neither the end of a script nor the start of a
    // comment: `<` occurs in strings only.
    serde_json::json!({ "columns": columns, "plots": plots }).to_string().replace('<', "\\u003c")
}

/// Values rounded to tenths, because finer differences of colour cannot be seen.
fn tenths(rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    rows.iter().map(|row| row.iter().map(|v| (10.0 * v).round() / 10.0).collect()).collect()
}

/// Values rounded to visible precision: a hundred-thousandth of the column's range, or six significant digits
/// for columns that span decades. NaN becomes `null` in JSON.
fn rounded(values: &[f64]) -> Vec<f64> {
    let finite = || values.iter().copied().filter(|v| v.is_finite());
    let (low, high) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let range = high - low;
    let least = finite().map(f64::abs).filter(|v| *v > 0.0).fold(f64::INFINITY, f64::min);
    if range.is_nan() || range <= 0.0 || high > 0.0 && low >= 0.0 && high / least > 1e4 {
        return values.iter().map(|v| significant(*v)).collect();
    }
    let scale = 10f64.powi((5.0 - range.log10()).ceil() as i32);
    values.iter().map(|v| (v * scale).round() / scale).collect()
}

fn significant(v: f64) -> f64 {
    if v == 0.0 || !v.is_finite() {
        return v;
    }
    let scale = 10f64.powi(5 - v.abs().log10().floor() as i32);
    if scale.is_finite() && scale > 0.0 { (v * scale).round() / scale } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_points_stay_small_and_columns_are_shared() {
        let t: Vec<f64> = (0..100_000).map(|i| i as f64 * 1e-3).collect();
        let y: Vec<f64> = t.iter().map(|t| (t * 7.0).sin()).collect();
        let mut plot = Plot::over_time("a", "a", "deg");
        plot.traces = (0..40).map(|i| Trace::new(format!("line {i}"), i, Style::Main, &t, &y)).collect();
        let text = plots_json(&vec![plot; 4]);
        assert!(text.len() < 3_500_000, "{}", text.len());
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["columns"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn rounding_is_below_what_the_eye_sees() {
        let y = [1.234_567_89, -0.000_012_345, 0.5, f64::NAN];
        let r = rounded(&y);
        assert!(r.iter().zip(&y).take(3).all(|(a, b)| (a - b).abs() <= 1e-5 * 1.3));
        let decades = [1e-9, 1.0, 1e6];
        assert!(rounded(&decades).iter().zip(&decades).all(|(a, b)| (a / b - 1.0).abs() < 1e-5));
    }

    #[test]
    fn a_transient_at_the_start_does_not_flatten_the_rest() {
        let t: Vec<f64> = (0..1_000).map(f64::from).collect();
        let y: Vec<f64> = t.iter().map(|t| (0.1 * t).sin() + 40.0 * (-t).exp()).collect();
        let mut plot = Plot::over_time("a", "a", "deg");
        plot.traces.push(Trace::new("error", 0, Style::Main, &t, &y));
        let mut kept = plot.clone();
        kept.leave_out_start(|_| false);
        assert_eq!(kept.y_range, None, "the line is no transient");
        plot.leave_out_start(|_| true);
        let (low, high) = plot.y_range.unwrap();
        assert!(low < -1.0 && low > -1.2 && high > 1.0 && high < 1.2, "{low} {high}");
        assert!(plot.caption.contains("40.0 deg"), "{}", plot.caption);
    }

    #[test]
    fn names_cannot_leave_the_script() {
        let mut plot = Plot::over_time("a", "</script><!--<script>", "");
        plot.traces.push(Trace::new("</SCRIPT>", 0, Style::Main, &[0.0], &[f64::NAN]));
        let text = plots_json(&[plot]);
        assert!(!text.contains('<'), "{text}");
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["plots"][0]["title"], "</script><!--<script>");
        assert!(json["columns"][1][0].is_null());
    }
}
