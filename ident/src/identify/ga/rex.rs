//! Recombination: REX (real-coded ensemble crossover).

use whirlstand_vehicle::Stream;

use super::cost::Member;

/// Removes `count` random members from the population.
pub fn take_parents(population: &mut Vec<Member>, count: usize, stream: &mut Stream) -> Vec<Member> {
    let count = count.min(population.len());
    let mut parents = Vec::with_capacity(count);
    for _ in 0..count {
        let last = population.len() - 1;
        let index = (stream.uniform() * population.len() as f64) as usize;
        parents.push(population.swap_remove(index.min(last)));
    }
    parents
}

/// Children about the centre of the parents, as genes in [0, 1]; there is at least one parent.
pub fn children(parents: &[Member], count: usize, stream: &mut Stream) -> Vec<Vec<f64>> {
    let mean = |i: usize| parents.iter().map(|parent| parent.genes[i]).sum::<f64>() / parents.len() as f64;
    let centre: Vec<f64> = (0..parents[0].genes.len()).map(mean).collect();
    let width = (3.0 / parents.len() as f64).sqrt();
    let child = |_| {
        let mut genes = centre.clone();
        for parent in parents {
            let xi = width * (2.0 * stream.uniform() - 1.0);
            for ((g, p), c) in genes.iter_mut().zip(&parent.genes).zip(&centre) {
                *g += xi * (p - c);
            }
        }
        genes.iter_mut().for_each(|g| *g = reflected(*g));
        genes
    };
    (0..count).map(child).collect()
}

/// Reflects a gene at a bound of [0, 1].
fn reflected(gene: f64) -> f64 {
    let inside = if gene < 0.0 {
        -gene
    } else if gene > 1.0 {
        2.0 - gene
    } else {
        gene
    };
    inside.clamp(0.0, 1.0)
}
