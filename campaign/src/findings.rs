//! Statistics of the flights of a campaign.

use serde::Serialize;
use statrs::statistics::{Data, OrderStatistics};

use crate::correlation::rank_correlation;
use crate::proportion::Proportion;
use crate::quantity::Value;
use crate::table::{Columns, Ended, FigureColumn, Flight, Table, WEIGHT};

/// Number of flights that are listed as the worst.
const WORST: usize = 10;

/// Number of keys that are listed per figure.
const MOST_SENSITIVITIES: usize = 3;

/// Statistics of the flights of a campaign.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Findings {
    /// Share of the flights that violated a limit or did not end.
    pub violated: Proportion,
    /// Share of the flights that did not reach their end.
    pub failed: Proportion,
    /// Statistics of each limit.
    pub limits: Vec<LimitFindings>,
    /// Statistics of each figure that varies.
    pub figures: Vec<FigureFindings>,
    /// The worst flights, worst first: by the greatest figure in parts of its limit.
    pub worst: Vec<Worst>,
}

/// How often a limit was violated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LimitFindings {
    /// Key of the expectation.
    pub key: String,
    /// The limit, SI.
    pub limit: f64,
    /// Share of the completed flights that violated the limit.
    pub violated: Proportion,
}

/// Distribution of a figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FigureFindings {
    /// Key of the figure.
    pub key: String,
    /// SI unit.
    pub unit: String,
    /// Symbol of the unit in which it is shown.
    #[serde(skip)]
    pub shown: String,
    /// Number of flights in which it has a value.
    pub count: u64,
    /// Quantiles 0, 5, 50, 95 and 100 %.
    pub quantiles: [f64; 5],
    /// Keys that move it most.
    pub sensitivities: Vec<Sensitivity>,
}

/// Sensitivity of a figure to a key.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sensitivity {
    /// The key.
    pub key: String,
    /// Spearman's rank correlation, -1 to 1.
    pub rank_correlation: f64,
}

/// One of the worst flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worst {
    /// Its number.
    pub flight: u64,
    /// The limit that the flight violated most or came closest to.
    pub key: String,
    /// Its figure as a multiple of the limit; `None` without a figure, because the output never recovered or the
    /// flight ended early.
    pub of_limit: Option<f64>,
    /// How the flight ended, if it did not reach its end.
    pub ended: Option<String>,
}

/// Values of a key as numbers in all flights; words are numbered in alphabetical order.
pub(crate) fn numbers(flights: &[Flight], key: usize) -> Vec<f64> {
    let mut words: Vec<&str> = flights
        .iter()
        .filter_map(
            |f| if let Some(Value::Word(word)) = f.values.get(key) { Some(word.as_str()) } else { None },
        )
        .collect();
    words.sort_unstable();
    words.dedup();
    let number = |value: &Value| match value {
        Value::Word(word) => words.iter().position(|w| w == word).map_or(f64::NAN, |at| at as f64),
        value => value.number().unwrap_or(f64::NAN),
    };
    flights.iter().map(|f| f.values.get(key).map_or(f64::NAN, number)).collect()
}

impl Findings {
    /// Statistics of all flights of a table.
    pub fn of(table: &Table) -> Self {
        let (flights, columns) = (&table.flights, &table.info.columns);
        let count = |is: &dyn Fn(&Flight) -> bool| flights.iter().filter(|f| is(f)).count() as u64;
        let all = flights.len() as u64;
        let flown = count(&|f| f.ended == Ended::Complete);
        let weights = weights(table);
        // With weights all flights count, because a share among the completed ones would be biased.
        let proportion = |is: &dyn Fn(&Flight) -> bool, of: u64| match &weights {
            None => Proportion::new(count(is), of),
            Some(weights) => {
                let hits: Vec<f64> =
                    flights.iter().zip(weights).filter(|(f, _)| is(f)).map(|(_, weight)| *weight).collect();
                let most = weights.iter().copied().fold(1.0, f64::max);
                Proportion::weighted(&hits, all, most)
            }
        };
        let limits = columns.limits.iter().enumerate().map(|(i, (key, limit))| {
            let violated = proportion(&|f| f.holds.get(i) == Some(&false), flown);
            LimitFindings { key: key.clone(), limit: *limit, violated }
        });
        let draws: Vec<Vec<f64>> = (0..columns.keys.len()).map(|key| numbers(flights, key)).collect();
        Self {
            violated: violated(table, flights.len()),
            failed: proportion(&|f| f.ended != Ended::Complete, all),
            limits: limits.collect(),
            figures: (0..columns.figures.len())
                .filter(|i| columns.figures[*i].key != WEIGHT)
                .filter_map(|i| figure(table, &draws, weights.as_deref(), i))
                .collect(),
            worst: worst(flights, columns),
        }
    }
}

/// Share of the first `first` flights that violated a limit or did not end.
pub fn violated(table: &Table, first: usize) -> Proportion {
    let flights = &table.flights[..first.min(table.flights.len())];
    let of = flights.len() as u64;
    let Some(weights) = weights(table) else {
        return Proportion::new(flights.iter().filter(|f| !f.is_good()).count() as u64, of);
    };
    let broken = flights.iter().zip(&weights).filter(|(f, _)| !f.is_good()).map(|(_, weight)| *weight);
    Proportion::weighted(&broken.collect::<Vec<_>>(), of, weights.iter().copied().fold(1.0, f64::max))
}

/// Weights of the flights; `None` where all are the same.
fn weights(table: &Table) -> Option<Vec<f64>> {
    let at = table.info.columns.figures.iter().position(|figure| figure.key == WEIGHT)?;
    Some(table.flights.iter().map(|f| f.figures.get(at).copied().flatten().unwrap_or(1.0)).collect())
}

/// Weighted quantile: the value that the given share of the total weight does not exceed.
fn weighted_quantile(values: &[(f64, f64)], share: f64) -> f64 {
    let all: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut below = 0.0;
    let found = values.iter().find(|(_, weight)| {
        below += weight;
        below >= share * all
    });
    found.or(values.last()).map_or(f64::NAN, |(value, _)| *value)
}

fn figure(table: &Table, draws: &[Vec<f64>], weights: Option<&[f64]>, at: usize) -> Option<FigureFindings> {
    let columns = &table.info.columns;
    let values: Vec<f64> =
        table.flights.iter().map(|f| f.figures.get(at).copied().flatten().unwrap_or(f64::NAN)).collect();
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) =
        known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if known.is_empty() || low == high {
        return None;
    }
    let count = known.len() as u64;
    if let Some(weights) = weights {
        let weighted = values.iter().copied().zip(weights.iter().copied());
        let mut weighted: Vec<(f64, f64)> = weighted.filter(|(value, _)| value.is_finite()).collect();
        weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let FigureColumn { key, unit, shown } = columns.figures[at].clone();
        let quantiles = [0.0, 0.05, 0.5, 0.95, 1.0].map(|share| weighted_quantile(&weighted, share));
        // Ranks of draws from another distribution do not describe the nominal one.
        return Some(FigureFindings { key, unit, shown, count, quantiles, sensitivities: Vec::new() });
    }
    let mut known = Data::new(known);
    let mut sensitivities: Vec<Sensitivity> = columns
        .keys
        .iter()
        .zip(draws)
        .filter_map(|((key, _), draw)| {
            let rank_correlation = rank_correlation(draw, &values)?;
            Some(Sensitivity { key: key.clone(), rank_correlation })
        })
        .collect();
    sensitivities.sort_by(|a, b| b.rank_correlation.abs().total_cmp(&a.rank_correlation.abs()));
    sensitivities.truncate(MOST_SENSITIVITIES);
    let FigureColumn { key, unit, shown } = columns.figures[at].clone();
    let quantiles = [0.0, 0.05, 0.5, 0.95, 1.0].map(|tau| known.quantile(tau));
    Some(FigureFindings { key, unit, shown, count, quantiles, sensitivities })
}

/// The flights in the order of their greatest figure as a multiple of its limit; those without a figure come
/// first.
fn worst(flights: &[Flight], columns: &Columns) -> Vec<Worst> {
    let places: Vec<Option<usize>> = columns
        .limits
        .iter()
        .map(|(key, _)| columns.figures.iter().position(|figure| figure.key == *key))
        .collect();
    let mut all: Vec<(f64, Worst)> = flights
        .iter()
        .filter_map(|flight| {
            if let Ended::Failed(why) = &flight.ended {
                let key = String::new();
                return Some((
                    f64::INFINITY,
                    Worst { flight: flight.number, key, of_limit: None, ended: Some(why.clone()) },
                ));
            }
            let share = |i: usize| -> Option<f64> {
                let (_, limit) = columns.limits[i];
                let broken = flight.holds.get(i) == Some(&false);
                match places[i].and_then(|at| flight.figures.get(at).copied().flatten()) {
                    Some(figure) if limit > 0.0 => Some(figure / limit),
                    _ if broken => Some(f64::INFINITY),
                    _ => None,
                }
            };
            let greatest = (0..columns.limits.len())
                .filter_map(|i| Some((share(i)?, i)))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let (share, i) = greatest?;
            let of_limit = share.is_finite().then_some(share);
            Some((
                share,
                Worst { flight: flight.number, key: columns.limits[i].0.clone(), of_limit, ended: None },
            ))
        })
        .collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.flight.cmp(&b.1.flight)));
    all.into_iter().take(WORST).map(|(_, worst)| worst).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::TableInfo;

    fn table() -> Table {
        let columns = Columns {
            keys: vec![("gust".into(), "deg/s^2".into()), ("law".into(), String::new())],
            limits: vec![("roll.peak".into(), 0.5)],
            figures: [("roll.peak", "rad", "mrad"), ("u.rms", "", "")]
                .map(|(key, unit, shown)| FigureColumn {
                    key: key.into(),
                    unit: unit.into(),
                    shown: shown.into(),
                })
                .to_vec(),
        };
        let flights = (0..10u64).map(|n| {
            let peak = 0.1 * n as f64;
            let values = vec![
                Value::Number(crate::Number { value: 10.0 * n as f64, unit: "deg/s^2".into() }),
                Value::Word(if n % 2 == 0 { "lqr" } else { "smc" }.into()),
            ];
            match n {
                4 => Flight {
                    number: n,
                    values,
                    ended: Ended::Failed("it broke".into()),
                    holds: vec![],
                    figures: vec![None, None],
                },
                _ => Flight {
                    number: n,
                    values,
                    ended: Ended::Complete,
                    holds: vec![peak <= 0.5],
                    figures: vec![Some(peak), None],
                },
            }
        });
        let info = TableInfo {
            digest: "d".into(),
            version: "v".into(),
            flights: 10,
            shard: None,
            text: "t".into(),
            columns,
        };
        Table { info, flights: flights.collect() }
    }

    #[test]
    fn limits_are_counted_and_the_worst_come_first() {
        let found = Findings::of(&table());
        assert_eq!((found.violated.count, found.failed.count, found.limits[0].violated.count), (5, 1, 4));
        assert_eq!(found.limits[0].violated.of, 9);
        let order: Vec<u64> = found.worst.iter().map(|w| w.flight).collect();
        assert_eq!(order, [4, 9, 8, 7, 6, 5, 3, 2, 1, 0]);
        assert_eq!(found.worst[1].of_limit, Some(0.9 / 0.5));
        // The figure without any value is not told.
        assert_eq!(found.figures.len(), 1);
        assert_eq!(found.figures[0].sensitivities[0].key, "gust");
        assert!((found.figures[0].sensitivities[0].rank_correlation - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_table_is_written_read_and_joined_to_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        let whole = table();
        whole.write(&path("whole.parquet")).unwrap();
        assert_eq!(Table::read(&path("whole.parquet")).unwrap(), whole);
        let parts: Vec<(String, Table)> = (1..=3)
            .map(|part| {
                let shard = crate::Shard { part, of: 3 };
                let mut table = whole.clone();
                table.info.shard = Some(shard);
                table.flights.retain(|f| shard.has(f.number));
                let file = path(&format!("{part}.parquet"));
                table.write(&file).unwrap();
                (file.display().to_string(), Table::read(&file).unwrap())
            })
            .collect();
        Table::join(parts.iter().rev().cloned().collect()).unwrap().write(&path("joined.parquet")).unwrap();
        let bytes = |name: &str| std::fs::read(path(name)).unwrap();
        assert_eq!(bytes("joined.parquet"), bytes("whole.parquet"));

        let refused = |parts: Vec<(String, Table)>| Table::join(parts).unwrap_err().to_string();
        assert_eq!(refused(parts[..2].to_vec()), "parts 3/3 are missing");
        assert!(refused([&parts[..], &parts[..1]].concat()).contains("is part 1/3, which was already given"));
        let mut other = parts.clone();
        other[1].1.info.digest = "e".into();
        assert!(refused(other).contains("the campaign, its launch file, vehicle or seed differs"));
    }

    #[test]
    fn what_is_no_table_is_refused_in_words() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.parquet");
        std::fs::write(&path, "not parquet").unwrap();
        let error = Table::read(&path).unwrap_err().to_string();
        assert!(error.contains("cannot be read as Parquet"), "{error}");
        assert!(Table::read(&dir.path().join("b")).unwrap_err().to_string().contains("cannot read"));
    }
}
