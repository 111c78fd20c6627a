//! Thins lines for plots, as a whole or while they grow.

/// Thins a line to at most `most` points so that its picture stays the same: the points are put into buckets of
/// equal count, and of every bucket the first, smallest, greatest and last are kept (the M4 aggregation of Jugel
/// et al., VLDB 2014, for buckets narrower than a pixel). Every extreme and both ends survive. A gap (NaN) stays
/// a gap.
///
/// `t` and `y` have equal length; `most` below 8 counts as 8.
pub fn decimate(t: &[f64], y: &[f64], most: usize) -> (Vec<f64>, Vec<f64>) {
    let n = t.len().min(y.len());
    let most = most.max(8);
    if n <= most {
        return (t[..n].to_vec(), y[..n].to_vec());
    }
    let buckets = most / 4;
    let mut kept = (Vec::with_capacity(most), Vec::with_capacity(most));
    for b in 0..buckets {
        let mut bucket = Bucket::default();
        for i in b * n / buckets..(b + 1) * n / buckets {
            bucket.push(t[i], y[i]);
        }
        bucket.append_to(&mut kept.0, &mut kept.1);
    }
    kept
}

/// A point of a line with its position in its bucket.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    place: usize,
    t: f64,
    y: f64,
}

/// The points of a bucket that are kept.
#[derive(Debug, Clone, Default, PartialEq)]
struct Bucket {
    points: usize,
    /// First, smallest, greatest and last point.
    kept: Option<[Point; 4]>,
    /// First point without a value.
    gap: Option<Point>,
}

impl Bucket {
    fn push(&mut self, t: f64, y: f64) {
        let point = Point { place: self.points, t, y };
        self.points += 1;
        let kept = self.kept.get_or_insert([point; 4]);
        kept[3] = point;
        if y.is_nan() {
            self.gap.get_or_insert(point);
            return;
        }
        if kept[1].y.is_nan() || y < kept[1].y {
            kept[1] = point;
        }
        if kept[2].y.is_nan() || y > kept[2].y {
            kept[2] = point;
        }
    }

    /// Appends the kept points, each once and in order.
    fn append_to(&self, t: &mut Vec<f64>, y: &mut Vec<f64>) {
        let Some(mut kept) = self.kept else { return };
        if let Some(gap) = self.gap {
            // The gap replaces an end point, because the extremes matter more.
            kept[if gap.place == 0 { 0 } else { 3 }] = gap;
        }
        kept.sort_unstable_by_key(|point| point.place);
        for (i, point) in kept.iter().enumerate() {
            if i == 0 || kept[i - 1].place != point.place {
                t.push(point.t);
                y.push(point.y);
            }
        }
    }
}

/// Most points that a [`Line`] holds.
const LINE_POINTS: usize = 8_192;

/// A line that is thinned while it grows, so that its memory does not grow with it: at first every point is kept; each
/// time [`LINE_POINTS`] are reached, half of them are dropped as [`decimate`] does, and buckets are twice as wide from
/// then on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Line {
    t: Vec<f64>,
    y: Vec<f64>,
    /// Points per bucket; 0 as long as every point is kept.
    width: usize,
    /// The bucket that is being filled.
    bucket: Bucket,
}

impl Line {
    /// Appends a point; NaN is a gap.
    pub fn push(&mut self, t: f64, y: f64) {
        if self.width == 0 {
            self.t.push(t);
            self.y.push(y);
        } else {
            self.bucket.push(t, y);
            if self.bucket.points < self.width {
                return;
            }
            self.bucket.append_to(&mut self.t, &mut self.y);
            self.bucket = Bucket::default();
        }
        if self.t.len() + 4 > LINE_POINTS {
            (self.t, self.y) = decimate(&self.t, &self.y, LINE_POINTS / 2);
            // Four points are kept per bucket: half of the points of eight, a quarter of those of sixteen.
            self.width = if self.width == 0 { 8 } else { 2 * self.width };
        }
    }

    /// The points that are kept: abscissae and ordinates.
    pub fn points(&self) -> (Vec<f64>, Vec<f64>) {
        let (mut t, mut y) = (self.t.clone(), self.y.clone());
        self.bucket.append_to(&mut t, &mut y);
        (t, y)
    }

    /// True without a point.
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn extremes_order_and_size_survive(
            y in prop::collection::vec(prop_oneof![20 => -1e3..1e3f64, 1 => Just(f64::NAN)], 1..3000),
            most in 8usize..600,
        ) {
            let t: Vec<f64> = (0..y.len()).map(|i| i as f64 * 0.5).collect();
            let (td, yd) = decimate(&t, &y, most);
            prop_assert!(td.len() <= most.max(y.len().min(most)) && td.len() == yd.len());
            prop_assert!(td.windows(2).all(|w| w[0] < w[1]));
            let extreme = |v: &[f64], f: fn(f64, f64) -> f64| v.iter().copied().reduce(f).unwrap();
            let same = |a: f64, b: f64| a == b || a.is_nan() && b.is_nan();
            prop_assert!(same(extreme(&y, f64::min), extreme(&yd, f64::min)));
            prop_assert!(same(extreme(&y, f64::max), extreme(&yd, f64::max)));
            // Every kept point is a point of the record.
            for (t, y_kept) in td.iter().zip(&yd) {
                prop_assert!(same(y[(t * 2.0) as usize], *y_kept));
            }
            prop_assert_eq!(y.iter().any(|v| v.is_nan()), yd.iter().any(|v| v.is_nan()));
        }
    }

    #[test]
    fn a_short_line_is_untouched() {
        let t: Vec<f64> = (0..100).map(f64::from).collect();
        assert_eq!(decimate(&t, &t, 100), (t.clone(), t.clone()));
        assert_eq!(decimate(&[], &[], 10), (vec![], vec![]));
    }

    #[test]
    fn ends_survive_and_a_spike_is_not_lost() {
        let t: Vec<f64> = (0..10_000).map(f64::from).collect();
        let mut y = vec![0.0; 10_000];
        y[7_777] = 5.0;
        let (td, yd) = decimate(&t, &y, 200);
        assert_eq!((td[0], td[td.len() - 1]), (0.0, 9_999.0));
        assert!(yd.contains(&5.0) && td.contains(&7_777.0));
    }

    #[test]
    fn a_line_that_grows_keeps_its_extremes_and_its_size() {
        let mut line = Line::default();
        let y = |i: usize| if i == 777_777 { 5.0 } else { (i as f64 * 1e-3).sin() };
        for i in 0..1_000_000 {
            line.push(i as f64, y(i));
            assert!(line.t.len() <= LINE_POINTS);
            if i == 5_000 {
                assert_eq!(line.points().0.len(), 5_001);
            }
        }
        let (t, kept) = line.points();
        assert!(t.len() > LINE_POINTS / 4 && t.len() <= LINE_POINTS + 4, "{}", t.len());
        assert!(t.windows(2).all(|w| w[0] < w[1]));
        assert_eq!((t[0], t[t.len() - 1]), (0.0, 999_999.0));
        assert!(kept.contains(&5.0) && t.iter().zip(&kept).all(|(t, v)| *v == y(*t as usize)));
        // No part of the line is without points.
        assert!(t.windows(2).all(|w| w[1] - w[0] < 2.0 * 1_000_000.0 / (LINE_POINTS / 16) as f64));
    }
}
