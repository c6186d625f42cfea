//! Whether a room is so bright that bounces after the third make arrivals.
//!
//! In most rooms they are too weak for that. In a bright one there are more of them than of all other light, and those
//! over patches not yet in place pass for third bounces over patches that are not there. So they are looked for where
//! they must come: at the times of fourth bounces over visible patches and the surest hidden ones. Windows of the same
//! width to either side, where no path is due, tell how many arrivals chance puts there.

use super::chances::Recorded;
use super::paths::Graph;
use super::problem::{SensorProfiles, View};
use super::scene::Prediction;
use crate::association::Time;

/// Bounces of the paths that are looked for.
pub(super) const FOURTH: usize = 4;
/// Fourth bounces are seen if so many standard deviations more of their windows have an arrival than of those beside
/// them. The two profiles of a pair tell the same, so that these are 2.8 where all pairs have both.
const EXCESS_SIGMA: f64 = 4.0;
/// A window reaches so many standard deviations to either side. It tells of its own path where no other comes within
/// its own reach of it.
const OWN_SD: f64 = 2.0;
const ALONE_SD: f64 = 2.0 * OWN_SD;
/// How far beside a path's own window those are that tell of chance: that path comes not near them either.
const BESIDE_SD: f64 = 1.2 * ALONE_SD;

/// Windows, and how many of them have an arrival.
#[derive(Default)]
struct Windows {
    count: f64,
    seen: f64,
}

impl Windows {
    fn add(&mut self, is_seen: bool) {
        self.count += 1.0;
        self.seen += f64::from(u8::from(is_seen));
    }
}

/// Whether fourth bounces over the patches of the graphs' scene are seen.
pub(super) fn are_seen(graphs: &[Graph], sensors: &[SensorProfiles]) -> bool {
    let [mut own, mut beside] = [Windows::default(), Windows::default()];
    for (graph, sensor) in graphs.iter().zip(sensors) {
        for view in sensor.views().filter(|view| graph.scene.has(&view.profile.direct())) {
            count(graph, view, &mut own, &mut beside);
        }
    }
    let all = own.count + beside.count;
    let share = (own.seen + beside.seen) / all;
    let variance = share * (1.0 - share) * (own.count.recip() + beside.count.recip());
    // No number where there are no windows, or all are alike.
    own.seen / own.count - beside.seen / beside.count > EXCESS_SIGMA * variance.sqrt()
}

/// Adds the windows of one profile: those of fourth bounces that no other path comes near, and beside them.
fn count(graph: &Graph, view: View, own: &mut Windows, beside: &mut Windows) {
    let Recorded { arrivals, predictions, .. } = Recorded::new(graph, view, FOURTH);
    let is_seen = |time_ps: f64, sd_ps: f64| arrivals.iter().any(|one| (one.time_ps - time_ps).abs() < OWN_SD * sd_ps);
    // Paths that come near a time.
    let near = |at_ps: f64, sd_ps: f64| {
        let before = |limit_ps: f64| predictions.partition_point(|path| path.time.time_ps < limit_ps);
        before(at_ps + ALONE_SD * sd_ps) - before(at_ps - ALONE_SD * sd_ps)
    };
    for Prediction { path, time: Time { time_ps, sd_ps, .. }, .. } in &predictions {
        if path.len() != FOURTH || near(*time_ps, *sd_ps) > 1 {
            continue;
        }
        own.add(is_seen(*time_ps, *sd_ps));
        let sides = [-BESIDE_SD, BESIDE_SD].map(|sds| time_ps + sds * sd_ps);
        sides
            .into_iter()
            .filter(|at_ps| near(*at_ps, *sd_ps) == 0)
            .for_each(|at_ps| beside.add(is_seen(at_ps, *sd_ps)));
    }
}
