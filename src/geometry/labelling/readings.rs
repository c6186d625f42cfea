//! Whether a wide arrival is one pulse of light that patches spread, or two pulses that came close together.
//!
//! One profile alone hardly knows: both explain its samples about as well. The scene does. With a [`Scene`] all
//! arrivals of a profile are associated with the predicted paths as in [`crate::association`], a wide one read either
//! way: as a whole it takes one path or none, as a pair up to two different ones. With uniform priors of times, a
//! reading's weight is the integral of its likelihood over times, light and width (Laplace's method):
//!
//! ```text
//! whole:  s       P(w)  sqrt(2 pi) s_w    (clutter + sum odds N(t; t_p, s^2 + s_p^2))
//! pair:   sqrt(2 pi) sqrt(det C)  sqrt(2 pi) s_a  exp(gain / 2)  (the same for both, with the joint density of times)
//! ```
//!
//! with `s` the whole's sd and `C` the covariance of the pair's times; `gain` chi-square of the whole less that of the
//! pair; `P(w)` the chance, a picosecond, that patches spread light by its width w, known to s_w; and `s_a` the sd of
//! the share of light that either pulse has, shares from 0 to 1 being alike: where both times are given, the centroid's
//! error s over their distance. So the pair pays for its freedom by how far it narrows it.
//!
//! How wide light may be is seen on first bounces of patches that are lit and seen: no later light comes so soon behind
//! them. Each bounce adds as much variance, within a factor, since patches are met at other angles; a few widths are
//! anything. Without such bounces the `size_m` of patches says it.
//!
//! Two points in the place of two wide pulses lie too far apart, by the variance of each over their distance to either
//! side; that joins their error.
//!
//! Spread light is no Gaussian, so that its centroid is not where the samples have it: a tenth of its width joins the
//! whole's error. The strongest arrival of a patch that is lit and seen is its first bounce, and stays whole. Arrivals
//! that overlap it are light of the same patch in a shape that neither a point nor a Gaussian has (`gather`): all
//! together make the first bounce, at their centroid.
//!
//! Without a scene only first light matters. A wide arrival of two different patches is read as two where that is the
//! likelier; the error of its first light covers the other reading in any case.
//!
//! Not modelled: three pulses in one; strengths of light.

use super::assignment::{self, Prior};
use super::paths::Graph;
use super::problem::{Arrival, Loser, Options, Origin, Pair, Profile, SensorProfiles, Verdict, View};
use super::scene::{Prediction, Scene};
use crate::association::{Choice, Edge, Expected, Time, choose, edges};

/// A reading that is less probable is not kept.
const KEPT: f64 = 0.01;
/// Part of wide pulses that are as wide as anything, and the largest such width, ps.
const ANY_WIDTH: f64 = 0.01;
const WIDEST_PS: f64 = 300.0;
/// Light of other bounces is spread so many times as much as that of first ones: these meet patches at other angles.
const OTHER_ANGLES: f64 = 1.5;
/// The sd of a width that is given too small to be true.
const WIDTH_SD_MIN_PS: f64 = 0.5;
/// Evidence beyond this many units of chi-square is as good as certain.
const GAIN_MAX: f64 = 100.0;
/// Later light behind the first, arrivals a picosecond, where no scene predicts it.
const LATER_PER_PS: f64 = 5e-4;
/// Error of the centroid of spread light, in its widths.
const SHAPE_WIDTHS: f64 = 0.1;
/// A disk's rim is so many of its standard deviations of a coordinate apart; a bounce sees it twice, on its way there
/// and back, at some angle.
const DISK_SDS: f64 = 4.0;

/// How wide pulses of the campaign are.
pub(super) struct Widths {
    /// Root mean square of the widths of first bounces, ps.
    first_ps: f64,
}

/// Onsets as arrivals, each read one way.
pub(super) struct Readings {
    pub(super) sensors: Vec<SensorProfiles>,
    /// For each sensor, for each profile, where each arrival comes from.
    pub(super) origins: Vec<Vec<Vec<Origin>>>,
    /// For each sensor, for each profile, readings that are less likely.
    pub(super) losers: Vec<Vec<Vec<Loser>>>,
}

/// One profile, read.
#[derive(Default)]
struct Reading {
    arrivals: Vec<Arrival>,
    origins: Vec<Origin>,
    losers: Vec<Loser>,
}

impl Widths {
    /// Of first bounces, else of `size_m`.
    pub(super) fn of(sensors: &[SensorProfiles], scene: Option<&Scene>, blend_ps: f64) -> Self {
        let own = |view: View| first_bounce(view, scene, blend_ps).map(|n| view.profile.arrivals[n].width_ps.powi(2));
        let mut squares: Vec<f64> = sensors.iter().flat_map(|sensor| sensor.views().filter_map(own)).collect();
        // One that is not spread by its patch does not speak for the others.
        squares.sort_by(f64::total_cmp);
        squares.truncate((squares.len() * 9).div_ceil(10));
        if !squares.is_empty() {
            let mean = squares.iter().sum::<f64>() / squares.len() as f64;
            return Self { first_ps: mean.sqrt() };
        }
        let size_m = scene.map_or(0.0, Scene::largest_m);
        let medium = sensors.first().map(|sensor| sensor.medium);
        let by_size_ps = medium.map_or(0.0, |medium| medium.time_ps(2.0 * size_m / DISK_SDS));
        Self { first_ps: if size_m > 0.0 { by_size_ps } else { WIDEST_PS } }
    }

    /// Variance that a path of so many bounces gives its light, ps^2.
    fn variance_ps2(&self, bounces: usize) -> f64 {
        let each_ps = if bounces > 1 { OTHER_ANGLES * self.first_ps } else { self.first_ps };
        bounces as f64 * each_ps * each_ps
    }

    /// Chance, a picosecond, that light of so many bounces is as wide as an arrival looks, times the volume of widths
    /// that its samples leave.
    fn factor(&self, arrival: &Arrival, bounces: usize) -> f64 {
        let sd_ps = arrival.width_sd_ps.max(WIDTH_SD_MIN_PS);
        let variance_ps2 = self.variance_ps2(bounces) + sd_ps * sd_ps;
        let usual = 2.0 * normal(arrival.width_ps, variance_ps2);
        let density = (1.0 - ANY_WIDTH) * usual + ANY_WIDTH / WIDEST_PS;
        density * root_tau() * sd_ps
    }
}

impl Pair {
    fn apart_ps(&self) -> f64 {
        (self.times_ps[1] - self.times_ps[0]).max(f64::MIN_POSITIVE)
    }

    /// The covariance of the times where both pulses are spread by so much variance.
    fn covariance_ps2(&self, variance_ps2: f64) -> [f64; 3] {
        let off_ps = (variance_ps2 / self.apart_ps()).min(0.5 * self.apart_ps());
        let [first, both, second] = self.covariance_ps2;
        [first + off_ps * off_ps, both - off_ps * off_ps, second + off_ps * off_ps]
    }

    /// Weight of the pair against the whole, but for when their light comes and how wide it may be.
    fn factor(&self, whole: &Arrival) -> f64 {
        let [first, both, second] = self.covariance_ps2;
        let volume_ps2 = (first * second - both * both).max(0.0).sqrt();
        let share = (root_tau() * whole.sd_ps / self.apart_ps()).min(1.0);
        let gain = self.gain.clamp(-GAIN_MAX, GAIN_MAX);
        root_tau() * volume_ps2 / whole.sd_ps * share * (0.5 * gain).exp()
    }

    /// Both pulses as arrivals of a certainty.
    fn parts(&self, whole: &Arrival, [first, _, second]: [f64; 3], certainty: f64) -> [Arrival; 2] {
        [(0, first), (1, second)].map(|(n, variance_ps2)| Arrival {
            amplitude: whole.amplitude * self.snrs[n] / whole.snr,
            blended: true,
            certainty: certainty * whole.certainty,
            ..Arrival::point(self.times_ps[n], variance_ps2.sqrt(), self.snrs[n])
        })
    }
}

impl Readings {
    /// Every onset as a whole; `blend_ps` as in [`Options`].
    pub(super) fn whole(sensors: &[SensorProfiles], scene: Option<&Scene>, blend_ps: f64) -> Self {
        Self::each(sensors, scene, blend_ps, |sensor| sensor.profiles.iter().map(Reading::whole).collect())
    }

    /// As the paths of a scene have them.
    pub(super) fn by_scene(
        sensors: &[SensorProfiles],
        graphs: &[Graph],
        widths: &Widths,
        prior: &Prior,
        options: &Options,
    ) -> Self {
        let mut at = graphs.iter();
        let scene = graphs.first().map(|graph| graph.scene);
        Self::each(sensors, scene, options.blend_ps, |sensor| {
            let graph = at.next().expect("each sensor has a graph");
            let of_profile = |profile: &Profile| {
                let view = View { sensor, profile };
                Context { graph, view, widths, prior, options }.read()
            };
            sensor.profiles.iter().map(of_profile).collect()
        })
    }

    /// By what wide and blended light is like, for first light.
    pub(super) fn blind(sensors: &[SensorProfiles], blend_ps: f64) -> Self {
        let widths = Widths::of(&Self::whole(sensors, None, blend_ps).sensors, None, blend_ps);
        Self::each(sensors, None, blend_ps, |sensor| {
            sensor.profiles.iter().map(|profile| blind(profile, &widths)).collect()
        })
    }

    /// Reads all profiles, first bounces gathered.
    fn each(
        sensors: &[SensorProfiles],
        scene: Option<&Scene>,
        blend_ps: f64,
        mut read: impl FnMut(&SensorProfiles) -> Vec<Reading>,
    ) -> Self {
        let mut all = Self { sensors: Vec::new(), origins: Vec::new(), losers: Vec::new() };
        for sensor in sensors {
            let gathered: Vec<Gathered> = sensor.views().map(|view| gather(view, scene, blend_ps)).collect();
            let profiles = gathered.iter().map(|gathered| gathered.profile.clone()).collect();
            let sensor = SensorProfiles { profiles, ..sensor.clone() };
            let (mut profiles, mut origins, mut losers) = (Vec::new(), Vec::new(), Vec::new());
            for (gathered, reading) in gathered.into_iter().zip(read(&sensor)) {
                let reading = reading.of(&gathered);
                profiles.push(Profile { arrivals: reading.arrivals, ..gathered.profile });
                origins.push(reading.origins);
                losers.push(reading.losers);
            }
            all.sensors.push(SensorProfiles { profiles, ..sensor });
            all.origins.push(origins);
            all.losers.push(losers);
        }
        all
    }
}

/// A profile whose first bounce is one arrival.
struct Gathered {
    profile: Profile,
    /// For each arrival, the onset that it is.
    onsets: Vec<usize>,
    /// Onsets that the first bounce holds besides its own.
    inner: Vec<(usize, Arrival)>,
}

/// Joins arrivals that overlap the first bounce of a patch that is lit and seen, and come within `blend_ps` of it, with
/// it. Light over another patch would come so soon only from a centimetre away.
fn gather(view: View, scene: Option<&Scene>, blend_ps: f64) -> Gathered {
    let (profile, first) = (view.profile, first_bounce(view, scene, blend_ps));
    let at = |n: usize| &profile.arrivals[n];
    let is_inner = |n: usize| {
        first.is_some_and(|first| {
            n != first && at(n).blended && (at(n).time_ps - at(first).time_ps).abs() < blend_ps && at(n).amplitude > 0.0
        })
    };
    let (inner, onsets): (Vec<usize>, Vec<usize>) = (0..profile.arrivals.len()).partition(|&n| is_inner(n));
    let whole = |n: usize| {
        if first != Some(n) || inner.is_empty() {
            return *at(n);
        }
        let parts: Vec<&Arrival> = std::iter::once(n).chain(inner.iter().copied()).map(at).collect();
        let per_amplitude = profile.arrivals.iter().map(|arrival| arrival.snr / arrival.amplitude.abs());
        centroid(&parts, per_amplitude.filter(|ratio| ratio.is_finite()).fold(0.0, f64::max))
    };
    let arrivals = onsets.iter().map(|&n| whole(n)).collect();
    let inner = inner.iter().map(|&n| (n, *at(n))).collect();
    Gathered { profile: Profile { arrivals, ..profile.clone() }, onsets, inner }
}

/// The strongest arrival of a patch that is lit and seen. With a scene it must come where that has it: a record may
/// have been gated behind the first bounce.
fn first_bounce(view: View, scene: Option<&Scene>, blend_ps: f64) -> Option<usize> {
    let Profile { lit, seen, arrivals, .. } = view.profile;
    let strongest = (0..arrivals.len()).max_by(|&a, &b| arrivals[a].amplitude.total_cmp(&arrivals[b].amplitude));
    let is_in_place = |n: &usize| {
        let Some(scene) = scene else { return true };
        let direct = view.profile.direct();
        scene.has(&direct) && view.off_ps(arrivals[*n].time_ps, scene.predict(direct, view).time.time_ps) < blend_ps
    };
    strongest.filter(|n| lit == seen && is_in_place(n))
}

/// All light of several arrivals as one. Their errors are taken for independent: those of overlapping pulses are
/// opposed, so that their centroid is known better. How that light divides is not certain, but how much it is: its
/// signal-to-noise ratio is `per_amplitude`, that of the arrival of its profile whose amplitude is known best.
fn centroid(parts: &[&Arrival], per_amplitude: f64) -> Arrival {
    let amplitude: f64 = parts.iter().map(|part| part.amplitude).sum();
    let mean = |value: &dyn Fn(&Arrival) -> f64| {
        parts.iter().map(|part| part.amplitude / amplitude * value(part)).sum::<f64>()
    };
    let time_ps = mean(&|part| part.time_ps);
    let variance_ps2: f64 = parts.iter().map(|part| (part.amplitude / amplitude * part.sd_ps).powi(2)).sum();
    let width_ps2 = mean(&|part| part.width_ps.powi(2) + (part.time_ps - time_ps).powi(2));
    Arrival {
        amplitude,
        width_ps: width_ps2.sqrt(),
        width_sd_ps: mean(&|part| part.width_sd_ps),
        ..Arrival::point(time_ps, variance_ps2.sqrt(), per_amplitude * amplitude)
    }
}

impl Reading {
    /// Every arrival as it is.
    fn whole(profile: &Profile) -> Self {
        let mut reading = Self::default();
        profile.arrivals.iter().enumerate().for_each(|(onset, arrival)| reading.add(onset, 0, *arrival));
        reading
    }

    /// Of the onsets that a profile was gathered from.
    fn of(mut self, gathered: &Gathered) -> Self {
        let origins = self.origins.iter_mut().chain(self.losers.iter_mut().map(|loser| &mut loser.origin));
        origins.for_each(|origin| origin.onset = gathered.onsets[origin.onset]);
        gathered.inner.iter().for_each(|(onset, arrival)| self.lose(*onset, 0, arrival, Verdict::open()));
        self
    }

    fn add(&mut self, onset: usize, part: i32, arrival: Arrival) {
        self.arrivals.push(arrival);
        self.origins.push(Origin { onset, part, with_other_ps2: 0.0 });
    }

    /// Both pulses of an onset, and the covariance of their times.
    fn add_parts(&mut self, onset: usize, parts: &[Arrival; 2], with_other_ps2: f64) {
        self.arrivals.extend(parts);
        self.origins.extend([1, 2].map(|part| Origin { onset, part, with_other_ps2 }));
    }

    fn lose(&mut self, onset: usize, part: i32, arrival: &Arrival, verdict: Verdict) {
        let Arrival { time_ps, sd_ps, .. } = *arrival;
        self.losers.push(Loser { origin: Origin { onset, part, with_other_ps2: 0.0 }, time_ps, sd_ps, verdict });
    }
}

/// Where a profile is read.
struct Context<'a> {
    graph: &'a Graph<'a>,
    view: View<'a>,
    widths: &'a Widths,
    prior: &'a Prior<'a>,
    options: &'a Options,
}

/// An arrival with all that may have made it.
struct Item {
    /// The first is the whole without a path.
    choices: Vec<Choice>,
    /// Choices of the whole come first, so many of them.
    wholes: usize,
    parts: Option<[Arrival; 2]>,
    /// Covariance of the times of the parts, ps^2.
    with_other_ps2: f64,
}

impl Context<'_> {
    fn read(&self) -> Reading {
        let arrivals = &self.view.profile.arrivals;
        if arrivals.iter().all(|arrival| arrival.pair.is_none()) {
            return Reading::whole(self.view.profile);
        }
        let mut reading = Reading::default();
        let (predictions, clutter_per_ps) = self.predictions();
        let seen = |prediction: &Prediction| self.prior.of(self.graph.scene, &prediction.path);
        let expected: Vec<Expected> =
            predictions.iter().map(|path| Expected { time: path.time, seen: seen(path) }).collect();
        let first_bounce = first_bounce(self.view, Some(self.graph.scene), self.options.blend_ps);
        let item = |(n, arrival): (usize, &Arrival)| {
            let pair = arrival.pair.filter(|_| first_bounce != Some(n));
            self.item(&Arrival { pair, ..*arrival }, &predictions, &expected, clutter_per_ps)
        };
        let items: Vec<Item> = arrivals.iter().enumerate().map(item).collect();
        let mut order: Vec<usize> = (0..arrivals.len()).collect();
        order.sort_by(|&a, &b| arrivals[a].time_ps.total_cmp(&arrivals[b].time_ps));
        let in_order: Vec<Vec<Choice>> = order.iter().map(|&n| items[n].choices.clone()).collect();
        let mut shares = vec![Vec::new(); arrivals.len()];
        order.iter().zip(choose(&in_order)).for_each(|(&n, of_item)| shares[n] = of_item);
        for (onset, (item, shares)) in items.iter().zip(&shares).enumerate() {
            reading.settle(onset, &arrivals[onset], item, shares, &predictions);
        }
        reading
    }

    /// Paths near the arrivals, each read either way, and the density of unpredicted light.
    fn predictions(&self) -> (Vec<Prediction>, f64) {
        let mut profile = self.view.profile.clone();
        let parts = self.view.profile.arrivals.iter().filter_map(|arrival| self.parts(arrival, 1.0));
        profile.arrivals.extend(parts.flatten());
        let view = View { profile: &profile, ..self.view };
        let paths = assignment::paths(self.graph, view, self.options.bounces, 0.0);
        let predictions = assignment::readings(paths.predictions, view, 0.0);
        (predictions, self.options.clutter_per_ns * 1e-3)
    }

    /// Both pulses that an arrival may be.
    fn parts(&self, arrival: &Arrival, certainty: f64) -> Option<[Arrival; 2]> {
        let pair = arrival.pair?;
        Some(pair.parts(arrival, pair.covariance_ps2(self.widths.variance_ps2(2)), certainty))
    }

    fn item(&self, whole: &Arrival, predictions: &[Prediction], expected: &[Expected], clutter_per_ps: f64) -> Item {
        let bounces = |path: usize| predictions[path].path.len();
        let shape_ps = if whole.pair.is_some() { SHAPE_WIDTHS * whole.width_ps } else { 0.0 };
        let time = Time { sd_ps: whole.sd_ps.hypot(shape_ps), ..whole.time() };
        let own = edges(&[time], expected, &[clutter_per_ps]).remove(0);
        let width = |bounces: usize| if whole.pair.is_some() { self.widths.factor(whole, bounces) } else { 1.0 };
        let latest = self.options.bounces.max(2);
        let mut choices = vec![Choice { paths: [None, None], weight: width(latest) }];
        choices.extend(
            own.iter()
                .map(|edge| Choice { paths: [Some(edge.path), None], weight: edge.weight * width(bounces(edge.path)) }),
        );
        let wholes = choices.len();
        let parts = self.parts(whole, 1.0);
        let mut with_other_ps2 = 0.0;
        if let (Some(pair), Some(parts)) = (whole.pair, parts) {
            let covariance_ps2 = pair.covariance_ps2(self.widths.variance_ps2(2));
            with_other_ps2 = covariance_ps2[1];
            let factor = pair.factor(whole) * clutter_per_ps;
            let [first, second] = parts.map(|part| edges(&[part.time()], expected, &[clutter_per_ps]).remove(0));
            choices.push(Choice { paths: [None, None], weight: factor });
            let one = |edge: &Edge| Choice { paths: [Some(edge.path), None], weight: factor * edge.weight };
            let other = |edge: &Edge| Choice { paths: [None, Some(edge.path)], weight: factor * edge.weight };
            choices.extend(first.iter().map(one));
            choices.extend(second.iter().map(other));
            for (a, b) in first.iter().flat_map(|a| second.iter().map(move |b| (a, b))) {
                if a.path != b.path {
                    let more_ps2 = [a, b].map(|edge| expected[edge.path].time.sd_ps.powi(2));
                    let weight = factor * a.weight * b.weight * jointly(a, b, covariance_ps2, more_ps2);
                    choices.push(Choice { paths: [Some(a.path), Some(b.path)], weight });
                }
            }
        }
        Item { choices, wholes, parts, with_other_ps2 }
    }
}

impl Reading {
    /// Takes the likelier reading of an onset, and keeps the other.
    fn settle(&mut self, onset: usize, whole: &Arrival, item: &Item, shares: &[f64], predictions: &[Prediction]) {
        let Some(parts) = item.parts else {
            self.add(onset, 0, *whole);
            return;
        };
        let of_whole: f64 = shares[..item.wholes].iter().sum();
        let of_pair = (1.0 - of_whole).max(0.0);
        let verdict = |path: Option<usize>, arrival: &Arrival, probability: f64| match path {
            None => Verdict { probability, ..Verdict::open() },
            Some(path) => {
                let Prediction { path, turns, time } = &predictions[path];
                let residual_ps = Some(arrival.time_ps - time.time_ps);
                Verdict { turns: *turns, path: Some(path.clone()), residual_ps, probability, ..Verdict::open() }
            }
        };
        let best = |range: std::ops::Range<usize>| {
            let best = range.max_by(|&a, &b| shares[a].total_cmp(&shares[b])).expect("a reading has a choice");
            item.choices[best].paths
        };
        if of_whole >= of_pair {
            self.add(onset, 0, Arrival { certainty: of_whole, ..*whole });
            let paths = best(item.wholes..shares.len());
            for (n, part) in parts.iter().enumerate().filter(|_| of_pair >= KEPT) {
                self.lose(onset, n as i32 + 1, part, verdict(paths[n], part, of_pair));
            }
        } else {
            let parts = parts.map(|part| Arrival { certainty: of_pair, ..part });
            self.add_parts(onset, &parts, item.with_other_ps2);
            if of_whole >= KEPT {
                self.lose(onset, 0, whole, verdict(best(0..item.wholes)[0], whole, of_whole));
            }
        }
    }
}

/// First light that a wide arrival may be, of a profile whose paths are not known.
fn blind(profile: &Profile, widths: &Widths) -> Reading {
    let mut reading = Reading::default();
    for (onset, whole) in profile.arrivals.iter().enumerate() {
        // No other light comes so soon behind a first bounce.
        let Some(pair) = whole.pair.filter(|_| profile.lit != profile.seen) else {
            reading.add(onset, 0, *whole);
            continue;
        };
        let covariance_ps2 = pair.covariance_ps2(widths.variance_ps2(2));
        let two = pair.factor(whole) * LATER_PER_PS;
        let of_pair = two / (two + widths.factor(whole, 2));
        let [mut first, second] = pair.parts(whole, covariance_ps2, of_pair);
        let moved_ps = whole.time_ps - first.time_ps;
        let open = || Verdict::open();
        if of_pair > 0.5 {
            first.sd_ps = first.sd_ps.hypot((1.0 - of_pair).sqrt() * moved_ps);
            reading.add_parts(onset, &[first, second], covariance_ps2[1]);
            if 1.0 - of_pair >= KEPT {
                reading.lose(onset, 0, whole, Verdict { probability: 1.0 - of_pair, ..open() });
            }
        } else {
            let sd_ps = whole.sd_ps.hypot(of_pair.sqrt() * moved_ps);
            for (part, arrival) in (1..).zip([first, second]).filter(|_| of_pair >= KEPT) {
                reading.lose(onset, part, &arrival, Verdict { probability: of_pair, ..open() });
            }
            reading.add(onset, 0, Arrival { sd_ps, certainty: 1.0 - of_pair, ..*whole });
        }
    }
    reading
}

/// The joint density of two residuals over the product of their own.
fn jointly(a: &Edge, b: &Edge, [first, both, second]: [f64; 3], more_ps2: [f64; 2]) -> f64 {
    let (first, second) = (first + more_ps2[0], second + more_ps2[1]);
    let correlation = both / (first * second).sqrt();
    let (x, y) = (a.residual_ps / first.sqrt(), b.residual_ps / second.sqrt());
    let rest = 1.0 - correlation * correlation;
    let joint = (x * x - 2.0 * correlation * x * y + y * y) / rest;
    (-0.5 * (joint - x * x - y * y)).exp() / rest.sqrt()
}

fn normal(x: f64, variance: f64) -> f64 {
    (-0.5 * x * x / variance).exp() / (root_tau() * variance.sqrt())
}

fn root_tau() -> f64 {
    std::f64::consts::TAU.sqrt()
}
