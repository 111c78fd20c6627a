//! Thins lines for plots.

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
        let (from, until) = (b * n / buckets, (b + 1) * n / buckets);
        let mut keep = [from, from, from, until - 1];
        let mut gap = None;
        for i in from..until {
            if y[i].is_nan() {
                gap.get_or_insert(i);
                continue;
            }
            if y[keep[1]].is_nan() || y[i] < y[keep[1]] {
                keep[1] = i;
            }
            if y[keep[2]].is_nan() || y[i] > y[keep[2]] {
                keep[2] = i;
            }
        }
        if let Some(gap) = gap {
            // The gap takes the place of an end: the extremes matter more.
            keep[if gap == from { 0 } else { 3 }] = gap;
        }
        keep.sort_unstable();
        for (place, &i) in keep.iter().enumerate() {
            if place == 0 || keep[place - 1] != i {
                kept.0.push(t[i]);
                kept.1.push(y[i]);
            }
        }
    }
    kept
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
}
