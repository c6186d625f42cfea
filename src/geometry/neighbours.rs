//! The nearest points of each point.

use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Point;

/// The nearest points of each, itself first.
pub fn neighbours(points: &[Point], most: usize, cancel: &Cancel) -> Vec<Vec<u32>> {
    // Along the longest axis, neighbours lie within a run.
    let axis = (0..3).max_by(|a, b| extent(points, *a).total_cmp(&extent(points, *b))).unwrap_or(0);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by(|a, b| points[*a as usize][axis].total_cmp(&points[*b as usize][axis]).then(a.cmp(b)));
    let nearer = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let of_run = |run: usize| {
        let here = points[order[run] as usize];
        let mut list: Vec<(f64, u32)> = Vec::with_capacity(2 * most + 2);
        let mut reach_m2 = f64::INFINITY;
        let [mut before, mut after] = [run.checked_sub(1), Some(run)];
        while before.is_some() || after.is_some() {
            for (next, step) in [(&mut before, usize::MAX), (&mut after, 1)] {
                let Some(other) = next.and_then(|n| order.get(n)) else {
                    *next = None;
                    continue;
                };
                let apart = points[*other as usize] - here;
                let is_within = apart[axis] * apart[axis] <= reach_m2;
                if apart.norm_squared() <= reach_m2 {
                    list.push((apart.norm_squared(), *other));
                }
                // The end of the order ends a side too: `usize::MAX` more is one less.
                *next = next.filter(|n| is_within && (*n > 0 || step == 1)).map(|n| n.wrapping_add(step));
            }
            if list.len() > 2 * most {
                list.select_nth_unstable_by(most - 1, nearer);
                list.truncate(most);
                reach_m2 = list[most - 1].0;
            }
        }
        list.sort_unstable_by(nearer);
        list.truncate(most);
        list.into_iter().map(|one| one.1).collect::<Vec<u32>>()
    };
    let mut all = vec![Vec::new(); points.len()];
    let runs = (0..points.len()).into_par_iter().map(|run| {
        cancel.check();
        of_run(run)
    });
    for (run, list) in runs.collect::<Vec<_>>().into_iter().enumerate() {
        all[order[run] as usize] = list;
    }
    all
}

fn extent(points: &[Point], axis: usize) -> f64 {
    let ends = points
        .iter()
        .map(|point| point[axis])
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], x| [least.min(x), most.max(x)]);
    ends[1] - ends[0]
}
