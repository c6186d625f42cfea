//! The experiments, one a file, and what they share.

pub mod barcode;
mod barcode_bound;
mod barcode_figure;
pub mod hidden_plane;
pub mod mirror;
mod svg;

/// One draw a seed, on all cores. Not in rayon's own threads, which the runs need.
pub fn draws<T: Send>(count: u64, draw: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, |threads| threads.get() as u64);
    let share = |thread: u64| (1..=count).filter(|seed| seed % threads == thread).map(&draw).collect();
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|thread| scope.spawn(move || -> Vec<T> { share(thread) })).collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("a draw does not panic")).collect()
    })
}

/// The value that so large a share of values do not exceed.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((share * sorted.len() as f64).ceil() as usize).clamp(1, sorted.len()) - 1]
}
