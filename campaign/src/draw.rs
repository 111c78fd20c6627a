//! Sampling of the unit cube: the point of each flight, determined by its number alone.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::importance::Importance;
use crate::quantity::{Quantity, Value};

/// Sampling method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Independent random points.
    Random,
    /// Latin hypercube: each coordinate has one point in each of as many equal parts as there are flights (McKay,
    /// Beckman and Conover, Technometrics 21, 1979).
    LatinHypercube,
    /// Sobol's sequence, scrambled after Owen (Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020).
    Sobol,
    /// Every combination of the levels.
    Grid,
    /// Importance sampling: more points where failures are frequent, each flight with its weight.
    Importance,
}

impl Method {
    /// The method's word in a campaign file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::LatinHypercube => "latin-hypercube",
            Self::Sobol => "sobol",
            Self::Grid => "grid",
            Self::Importance => "importance",
        }
    }

    /// Whether the first flights are a sample like the whole: only then may a campaign stop early.
    pub fn may_stop_early(self) -> bool {
        matches!(self, Self::Random | Self::Sobol)
    }
}

/// Number of points of the scrambled sequence.
const MOST_SOBOL: u64 = 1 << 16;

/// Most points of a grid, and of a Latin hypercube, whose permutations are stored.
const MOST_LAID: u64 = 10_000_000;

/// The reason why points cannot be generated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DrawError {
    /// A grid needs a number of values for every key.
    #[error(
        "on a grid the key {0} needs discrete values: `among`, `integers`, or `uniform` with `levels` of at least 2"
    )]
    NoLevels(String),
    /// The sequence or the memory does not suffice.
    #[error(
        "{method} supports at most {most} flights, not {flights}: use \"random\", or several campaigns with different seeds"
    )]
    TooMany {
        /// The method.
        method: &'static str,
        /// Most flights.
        most: u64,
        /// Requested number of flights.
        flights: u64,
    },
}

/// Generator of the points.
#[derive(Debug, Clone)]
pub(crate) struct Draw {
    seed: u64,
    flights: u64,
    kind: Kind,
}

#[derive(Debug, Clone)]
enum Kind {
    Random,
    /// For each coordinate, the index of the part of each flight.
    LatinHypercube(Vec<Vec<u32>>),
    Sobol,
    /// For each quantity, its values on the grid.
    Grid(Vec<Vec<Value>>),
    Importance(Importance),
}

impl Draw {
    pub(crate) fn new(
        method: Method,
        seed: u64,
        flights: Option<u64>,
        quantities: &[Quantity],
        importance: Option<Importance>,
    ) -> Result<Self, DrawError> {
        let asked = flights.unwrap_or(0);
        let within = |most: u64| match asked <= most {
            true => Ok(()),
            false => Err(DrawError::TooMany { method: method.word(), most, flights: asked }),
        };
        let coordinates: usize = quantities.iter().map(Quantity::coordinates).sum();
        let (kind, flights) = match method {
            Method::Random => (Kind::Random, asked),
            // Without centre and spread, the draws follow the nominal distribution, each with weight 1.
            Method::Importance => (importance.map_or(Kind::Random, Kind::Importance), asked),
            Method::Sobol => {
                within(MOST_SOBOL)?;
                (Kind::Sobol, asked)
            }
            Method::LatinHypercube => {
                within(MOST_LAID)?;
                let shuffled = |coordinate: usize| {
                    let mut parts: Vec<u32> = (0..asked as u32).collect();
                    parts.shuffle(&mut stream(seed, coordinate as u64));
                    parts
                };
                (Kind::LatinHypercube((0..coordinates).map(shuffled).collect()), asked)
            }
            Method::Grid => {
                let values: Vec<Vec<Value>> = quantities
                    .iter()
                    .map(|q| {
                        q.grid()
                            .filter(|v| !v.is_empty())
                            .ok_or_else(|| DrawError::NoLevels(q.keys.join(", ")))
                    })
                    .collect::<Result<_, _>>()?;
                let whole = values.iter().try_fold(1u64, |n, v| n.checked_mul(v.len() as u64));
                let flights = whole.filter(|n| *n <= MOST_LAID).ok_or(DrawError::TooMany {
                    method: method.word(),
                    most: MOST_LAID,
                    flights: whole.unwrap_or(u64::MAX),
                })?;
                (Kind::Grid(values), flights)
            }
        };
        Ok(Self { seed, flights, kind })
    }

    pub(crate) fn flights(&self) -> u64 {
        self.flights
    }

    /// Values of all keys in a flight, in the order of the quantities.
    pub(crate) fn values(&self, flight: u64, quantities: &[Quantity]) -> Vec<Value> {
        if let Kind::Grid(levels) = &self.kind {
            // The last quantity changes fastest.
            let mut rest = flight;
            let mut values: Vec<Value> = levels
                .iter()
                .rev()
                .map(|values| {
                    let chosen = values[(rest % values.len() as u64) as usize].clone();
                    rest /= values.len() as u64;
                    chosen
                })
                .collect();
            values.reverse();
            return values;
        }
        let coordinates: usize = quantities.iter().map(Quantity::coordinates).sum();
        let point = self.point(flight, coordinates);
        let mut rest = point.as_slice();
        quantities
            .iter()
            .flat_map(|quantity| {
                let (own, others) = rest.split_at(quantity.coordinates());
                rest = others;
                quantity.at(own)
            })
            .collect()
    }

    /// Weight of a flight, where flights have different weights.
    pub(crate) fn weight(&self, flight: u64) -> Option<f64> {
        match &self.kind {
            Kind::Importance(importance) => {
                Some(importance.point(&mut stream(self.seed, (1 << 32) + flight)).1)
            }
            _ => None,
        }
    }

    /// The point of a flight in the unit cube; it has no meaning for a grid.
    pub(crate) fn point(&self, flight: u64, coordinates: usize) -> Vec<f64> {
        if let Kind::Importance(importance) = &self.kind {
            let point = importance.point(&mut stream(self.seed, (1 << 32) + flight)).0;
            return point.into_iter().map(|p| p.clamp(f64::EPSILON, 1.0 - f64::EPSILON)).collect();
        }
        // These streams are separate from those of the permutations.
        let mut within = stream(self.seed, (1 << 32) + flight);
        (0..coordinates)
            .map(|coordinate| match &self.kind {
                Kind::Sobol => {
                    // The scrambling key of 32 bits is drawn from the seed of 64.
                    let key = stream(self.seed, u64::MAX).random::<u32>();
                    f64::from(sobol_burley::sample(flight as u32, coordinate as u32, key)) + f64::EPSILON
                }
                Kind::LatinHypercube(parts) => {
                    let part = parts[coordinate].get(flight as usize).copied().unwrap_or(0);
                    (f64::from(part) + within.random::<f64>()) / self.flights.max(1) as f64
                }
                Kind::Random | Kind::Grid(_) | Kind::Importance(_) => within.random::<f64>(),
            })
            .map(|p| p.clamp(f64::EPSILON, 1.0 - f64::EPSILON))
            .collect()
    }
}

fn stream(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::{Spread, Variation};

    fn quantity(key: &str) -> Quantity {
        let variation = Variation::One(Spread::Uniform { ends: [0.0, 1.0], unit: String::new() });
        Quantity { keys: vec![key.into()], variation, levels: Some(3) }
    }

    fn drawn(method: Method, seed: u64, flights: u64) -> Vec<Vec<f64>> {
        let quantities = [quantity("a"), quantity("b")];
        let draw = Draw::new(method, seed, Some(flights), &quantities, None).unwrap();
        let row = |n| draw.values(n, &quantities).iter().filter_map(Value::number).collect();
        (0..draw.flights()).map(row).collect()
    }

    #[test]
    fn a_flight_draws_the_same_again_and_another_seed_something_else() {
        for method in [Method::Random, Method::LatinHypercube, Method::Sobol] {
            assert_eq!(drawn(method, 1, 50), drawn(method, 1, 50));
            assert_ne!(drawn(method, 1, 50), drawn(method, 2, 50), "{method:?}");
        }
    }

    #[test]
    fn each_part_of_a_latin_hypercube_has_one_flight() {
        for coordinate in 0..2 {
            let mut parts: Vec<usize> = drawn(Method::LatinHypercube, 3, 64)
                .iter()
                .map(|row| (row[coordinate] * 64.0) as usize)
                .collect();
            parts.sort_unstable();
            assert_eq!(parts, (0..64).collect::<Vec<_>>());
        }
    }

    /// A net in base 2: each of 16 x 16 boxes of equal size has one of the first 256 points.
    #[test]
    fn sobols_points_are_a_net() {
        let mut boxes = vec![0; 256];
        for row in drawn(Method::Sobol, 9, 256) {
            boxes[(row[0] * 16.0) as usize * 16 + (row[1] * 16.0) as usize] += 1;
        }
        assert!(boxes.iter().all(|n| *n == 1), "{boxes:?}");
    }

    #[test]
    fn a_grid_has_every_combination_and_says_what_it_cannot_count() {
        let rows = drawn(Method::Grid, 0, 0);
        assert_eq!((rows.len(), rows[0].clone(), rows[5].clone()), (9, vec![0.0, 0.0], vec![0.5, 1.0]));
        let mut free = quantity("x");
        free.levels = None;
        assert_eq!(
            Draw::new(Method::Grid, 0, None, &[free], None).unwrap_err(),
            DrawError::NoLevels("x".into())
        );
        let error = Draw::new(Method::Sobol, 0, Some(1 << 17), &[quantity("x")], None).unwrap_err();
        assert!(error.to_string().contains("65536"), "{error}");
    }
}
