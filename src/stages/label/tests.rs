//! Rows: what labels and hypotheses say of the onsets and patches given. The kernel has its own tests.

use super::*;
use crate::geometry::Point;
use crate::stages::stage::Rejection;
use crate::tables::Delay;
use std::path::Path;

const PERIOD_PS: f64 = 10_000.0;
/// The one hidden patch; the laser is at the origin.
const HIDDEN: [f64; 3] = [0.3, 1.0, 0.2];

/// Visible patches 1 to 8 near the wall y = 2 m, `relief_m` off it to either side in turn.
fn wall(relief_m: f64) -> Vec<Point> {
    let at = [(-0.8, -0.5), (-0.5, 0.6), (-0.1, -0.2), (0.2, 0.5), (0.5, -0.6), (0.8, 0.1), (1.1, 0.7), (1.2, -0.3)];
    let side = |n: usize| if n.is_multiple_of(2) { relief_m } else { -relief_m };
    at.iter().enumerate().map(|(n, (x, z))| Point::new(*x, 2.0 + side(n), *z)).collect()
}

fn onset(lit: PatchId, seen: PatchId, rank: i32, time_ps: f64) -> Onset {
    Onset {
        campaign: "c".into(),
        sensor: "s1".into(),
        lit,
        seen,
        range: Some("fine".into()),
        rank,
        time_ps,
        time_sd_ps: 20.0,
        amplitude: 1.0,
        snr: 10.0,
        jitter_ps: 15.0,
        ..Onset::default()
    }
}

/// Direct light of all pairs, and third bounces over the hidden patch.
fn onsets(points: &[Point]) -> Vec<Onset> {
    let over = Point::from(HIDDEN);
    let mut onsets = Vec::new();
    for (lit, a) in (1..).zip(points) {
        for (seen, b) in (1..).zip(points) {
            let ends_m = a.coords.norm() + b.coords.norm();
            for (rank, between_m) in (1..).zip([(a - b).norm(), (a - over).norm() + (b - over).norm()]) {
                onsets.push(onset(lit, seen, rank, crate::units::time_ps(ends_m + between_m, 1.0)));
            }
        }
    }
    onsets
}

fn patches(points: &[Point], variance_m2: Option<f64>) -> Vec<Patch> {
    let patch = |(patch, point): (PatchId, &Point)| Patch {
        patch,
        kind: "visible".into(),
        x_m: point.x,
        y_m: point.y,
        z_m: point.z,
        cov_xx_m2: variance_m2,
        cov_xy_m2: Some(0.0),
        cov_xz_m2: Some(0.0),
        cov_yy_m2: variance_m2,
        cov_yz_m2: Some(0.0),
        cov_zz_m2: variance_m2,
        sd_m: Some(1.7e-4),
        onsets: 1,
        ..Patch::default()
    };
    (1..).zip(points).map(patch).collect()
}

fn delay(range: Option<&str>, delay_ps: f64) -> Delay {
    Delay {
        campaign: "c".into(),
        sensor: "s1".into(),
        range: range.map(Into::into),
        delay_ps,
        sd_ps: 2.0,
        prior_sd_ps: 100.0,
        ..Delay::default()
    }
}

fn beside(points: &[Point], delays: &[Delay]) -> BesideTables {
    BesideTables::from([
        ("patches".to_owned(), vec![Patch::to_batch(&patches(points, Some(1e-8)))]),
        ("delays".to_owned(), vec![Delay::to_batch(delays)]),
    ])
}

fn context(stage: &LabelOnsets, keys: &str, beside: &BesideTables) -> Result<Context, StageError> {
    let text = format!("[campaign]\nname = 'c'\ngroup_index = 1.0\n{keys}\n[sensors.s1]\n");
    let campaign = Campaign::parse(Path::new("c"), &text).unwrap();
    stage.context(stage.fields(&[campaign]), beside)
}

/// Labels, hypotheses and rejections, with three bounces.
fn searched(points: &[Point], onsets: &[Onset], delays: &[Delay]) -> (Vec<Label>, Vec<Hypothesis>, Vec<Rejection>) {
    let stage = LabelOnsets { bounces: Count::new(3), ..LabelOnsets::default() };
    let outcome = stage.apply(&context(&stage, "", &beside(points, delays)).unwrap(), onsets.to_vec()).unwrap();
    (outcome.rows, Hypothesis::rows(&outcome.sides[0]).unwrap(), outcome.rejections)
}

/// The message of a refused context.
fn refusal(stage: &LabelOnsets, beside: &BesideTables) -> String {
    context(stage, "", beside).err().map(|error| error.to_string()).unwrap_or_default()
}

#[test]
fn a_label_is_its_onset_with_path_periods_and_shared_jitter() {
    let stage = LabelOnsets { near_m: NonNegative::new(1.6), ..LabelOnsets::default() };
    let context = context(&stage, "repetition_ps = 10000.0", &BesideTables::default()).unwrap();
    let onset = Onset { covariance: vec![400.0, 50.0], ..onset(7, 7, 1, 2500.0) };
    let rows = stage.apply(&context, vec![onset.clone()]).unwrap().rows;
    let [label] = &rows[..] else { panic!("one label, not {rows:?}") };
    assert_eq!((&*label.campaign, &*label.sensor, label.range.as_deref()), ("c", "s1", Some("fine")));
    assert_eq!((label.lit, label.seen, label.rank, label.alternative), (7, 7, 1, 0));
    assert_eq!((label.path.as_deref(), label.bounces, label.turns), (Some(&[7][..]), 1, 1));
    assert_eq!((label.time_ps, label.time_sd_ps, label.residual_ps), (2500.0 + PERIOD_PS, 25.0, None));
    assert_eq!(label.covariance, [400.0 + 225.0, 50.0 + 225.0]);
    // A part stands with the other one at its own rank.
    let part = labelling::Origin { onset: 0, part: 2, with_other_ps2: -30.0 };
    assert_eq!(rows::covariance_ps2(&onset, part), [-30.0, 50.0 + 225.0]);
}

/// An onset that other profiles predict is labelled by its time with that, and its label has the time without.
#[test]
fn a_label_has_the_time_that_its_profile_alone_gives() {
    let points = wall(0.1);
    let mut onsets = onsets(&points);
    let own_ps = onsets[0].time_ps + 70.0;
    onsets[0] = Onset { own_time_ps: Some(own_ps), covariance: vec![1600.0, 0.0], ..onsets[0].clone() };
    let (labels, _, _) = searched(&points, &onsets, &[]);
    let label = labels.iter().find(|label| (label.lit, label.seen, label.rank) == (1, 1, 1)).unwrap();
    assert_eq!(label.path.as_deref(), Some(&[1][..]));
    assert_eq!((label.time_ps, label.time_sd_ps), (own_ps, 1600_f64.sqrt().hypot(15.0)));
    assert!(label.residual_ps.unwrap().abs() < 1e-6, "{label:?}");
}

/// Of delays by range that of the onset's own counts, else the only one.
#[test]
fn onsets_are_predicted_with_the_delay_of_their_range() {
    let points = wall(0.1);
    let residual_ps = |delays: &[Delay]| {
        let (labels, _, _) = searched(&points, &onsets(&points), delays);
        labels.iter().find(|label| label.path.as_deref() == Some(&[1])).and_then(|label| label.residual_ps)
    };
    let off_ps = |delays: &[Delay]| residual_ps(delays).expect("a first bounce") + 10.0;
    assert!(off_ps(&[delay(Some("fine"), 10.0), delay(Some("coarse"), 500.0)]).abs() < 1e-6);
    assert!(off_ps(&[delay(None, 10.0)]).abs() < 1e-6);
    assert!((off_ps(&[delay(Some("medium"), 500.0), delay(Some("coarse"), 500.0)]) - 10.0).abs() < 1e-6);
}

#[test]
fn a_rival_is_the_alternative_of_its_hypothesis() {
    let points = wall(0.0012);
    let (labels, hypotheses, rejections) = searched(&points, &onsets(&points), &[]);
    assert!(rejections.is_empty());
    let of_patch: Vec<&Hypothesis> = hypotheses.iter().filter(|row| row.patch == Some(9)).collect();
    assert_eq!(of_patch.iter().map(|row| (row.hypothesis, row.alternative)).collect::<Vec<_>>(), [(1, 0), (1, 1)]);
    for (row, y_m) in of_patch.iter().zip([HIDDEN[1], 4.0 - HIDDEN[1]]) {
        assert!((row.y_m - y_m).abs() < 0.03 && &*row.kind == "patch" && row.normal_x.is_none(), "{row:?}");
        assert!((row.evidence_needed - 1000.0_f64.ln()).abs() < 1e-12);
    }
    let over = labels.iter().filter(|label| label.path.as_deref().is_some_and(|path| path.get(1) == Some(&9))).count();
    assert!(over > 30, "{over} of 64");
}

#[test]
fn visible_patches_in_one_line_are_a_rejection() {
    let line: Vec<Point> = (0..8).map(|n| Point::new(-0.8 + 0.25 * f64::from(n), 2.0, 0.1 * f64::from(n))).collect();
    let (labels, hypotheses, rejections) = searched(&line, &onsets(&line), &[]);
    assert!(hypotheses.is_empty() && labels.len() >= 128);
    assert!(
        rejections.len() == 1 && rejections[0].reason.contains("8 visible patches with known places lie in one line")
    );
}

#[test]
fn what_cannot_be_labelled_is_refused() {
    let stage = |bounces: u32| LabelOnsets { bounces: Count::new(bounces), ..LabelOnsets::default() };
    let (without, with) = (BesideTables::default(), beside(&wall(0.1), &[]));
    assert!(refusal(&stage(4), &without).contains("must be at most 3 without `patches`"));
    assert!(refusal(&stage(5), &with).is_empty() && refusal(&stage(3), &without).is_empty());
    let start = BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&patches(&wall(0.1), None))])]);
    assert!(refusal(&stage(3), &start).contains("no patch has a covariance"));
}
