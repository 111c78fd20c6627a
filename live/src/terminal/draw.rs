//! Draws a board in the terminal.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Row, Table};
use whirlstand_logs::shown::number;

use super::board::{Board, Shown};

/// Characters of a line, from low to high.
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Width of a table of signals before the line, in columns of characters.
const BEFORE_LINE: u16 = 74;

/// Draws a board.
pub(super) fn draw(frame: &mut Frame<'_>, board: &Board) {
    let heights = [
        Constraint::Length(2),
        Constraint::Length(board.outputs.len() as u16 + 3),
        Constraint::Length(board.inputs.len() as u16 + 3),
        Constraint::Length(board.nodes.len() as u16 + 3),
        Constraint::Min(3),
    ];
    let [head, outputs, inputs, nodes, events] = Layout::vertical(heights).areas(frame.area());
    let time = board.t.map_or("waiting for the bench".into(), |t| format!("t {t:.2} s"));
    let state = board.over.clone().unwrap_or(time);
    let title =
        Line::from(vec![Span::raw(board.title.as_str()).bold(), Span::raw("   "), Span::raw(state).cyan()]);
    let second = Line::from(format!("{}   (q quits)", board.subtitle)).dim();
    frame.render_widget(Paragraph::new(vec![title, second]), head);
    frame.render_widget(signals(board, "Outputs", &board.outputs, &OUTPUT, outputs), outputs);
    frame.render_widget(signals(board, "Inputs", &board.inputs, &INPUT, inputs), inputs);
    frame.render_widget(node_table(board), nodes);
    let lines = board.events.iter().map(|(t, text)| Line::from(format!("{t:9.2} s  {text}")));
    let events_block = Block::bordered().title("Events");
    frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()).block(events_block), events);
}

/// Heads of a table of signals, with the columns that they show; the first one with a column is drawn as a
/// line.
type Heads = [(&'static str, &'static str); 4];

const OUTPUT: Heads = [("measured", "y"), ("estimated", "e"), ("simulated", "s"), ("setpoint", "w")];
const INPUT: Heads = [("command", "u"), ("applied", "a"), ("", ""), ("", "")];

fn signals<'b>(board: &'b Board, title: &'b str, list: &'b [Shown], heads: &Heads, area: Rect) -> Table<'b> {
    let width = usize::from(area.width.saturating_sub(BEFORE_LINE));
    let rows = list.iter().map(|signal| {
        let mut cells = vec![signal.name.clone()];
        for (_, kind) in heads {
            let value = board.newest(&format!("{kind}.{}", signal.name));
            cells.push(value.map_or(String::new(), |v| format!("{} {}", number(v), signal.unit)));
        }
        let column = format!("{}.{}", heads[0].1, signal.name);
        let mut values: Vec<_> = board.line(&column).rev().take(width).collect();
        values.reverse();
        cells.push(bars(&values, signal.limits));
        Row::new(cells)
    });
    let widths = [22, 12, 12, 12, 12].map(Constraint::Length).into_iter().chain([Constraint::Min(0)]);
    let head = ["signal"].into_iter().chain(heads.iter().map(|(head, _)| *head)).chain([""]);
    Table::new(rows, widths)
        .header(Row::new(head).style(Style::new().fg(Color::DarkGray)))
        .block(Block::bordered().title(title))
}

/// Values as a line of characters, scaled between the limits or between the least and the greatest value.
fn bars(values: &[f64], limits: Option<(f64, f64)>) -> String {
    let ends = |(low, high): (f64, f64), v: &f64| (low.min(*v), high.max(*v));
    let (low, high) = limits.unwrap_or_else(|| values.iter().fold((f64::MAX, f64::MIN), ends));
    let place = |v: &f64| {
        let share = if high > low { (v - low) / (high - low) } else { 0.5 };
        BARS[((share * BARS.len() as f64) as usize).min(BARS.len() - 1)]
    };
    values.iter().map(place).collect()
}

fn node_table(board: &Board) -> Table<'_> {
    let heads = ["node", "state", "steps", "misses", "lost", "rejected", "restarts", "99 %", "CPU"];
    let rows = board.nodes.iter().map(|node| {
        let mut cells = vec![node.name.clone(), node.state.clone()];
        cells.extend(node.counts.iter().map(u64::to_string));
        cells.push(node.p99_us.map_or(String::new(), |us| format!("{} us", number(us))));
        cells.push(node.cpu_percent.map_or(String::new(), |percent| format!("{percent:.0} %")));
        let colour = if node.state == "running" { Color::Reset } else { Color::Yellow };
        Row::new(cells).style(Style::new().fg(colour))
    });
    let widths = [14, 10, 12, 8, 8, 10, 10, 12, 8].map(Constraint::Length);
    Table::new(rows, widths)
        .header(Row::new(heads).style(Style::new().fg(Color::DarkGray)))
        .block(Block::bordered().title("Nodes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    #[test]
    fn a_frame_is_drawn_with_names_values_nodes_and_events() {
        let mut board = Board::default();
        board.take(
            r#"{"scene":{"title":"lab","subtitle":"quadrotor","outputs":[{"name":"roll","unit":"deg","limits":null}],
               "inputs":[{"name":"u_roll","unit":"","limits":[-1,1]}]},"columns":["y.roll","e.roll","u.u_roll"]}"#,
        );
        board.take(
            r#"{"t":1.5,"rows":{"step":[299,300],"values":[[1.0,2.5],[null,null],[0.5,null]]},
               "events":[{"t":1.2,"kind":"asked","text":"gust on roll_rate"}],
               "nodes":[{"node":"plant","state":"running","steps":300,"misses":2,"p99_us":90.5}]}"#,
        );
        let mut terminal = Terminal::new(TestBackend::new(120, 30)).unwrap();
        terminal.draw(|frame| draw(frame, &board)).unwrap();
        let text = terminal.backend().to_string();
        for words in [
            "lab   t 1.50 s",
            "roll ",
            "2.50 deg",
            "u_roll",
            "0.500",
            "plant",
            "90.5 us",
            "1.20 s  gust on roll_rate",
        ] {
            assert!(text.contains(words), "{words}:\n{text}");
        }
        board.take(r#"{"over":"bench lab is over"}"#);
        terminal.draw(|frame| draw(frame, &board)).unwrap();
        assert!(terminal.backend().to_string().contains("bench lab is over"));
    }

    #[test]
    fn a_line_goes_from_low_to_high() {
        assert_eq!(bars(&[0.0, 0.5, 1.0], None), "▁▅█");
        assert_eq!(bars(&[0.0], Some((-1.0, 1.0))), "▅");
        assert_eq!(bars(&[3.0, 3.0], None), "▅▅");
    }
}
