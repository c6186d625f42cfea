use super::*;

fn fit(chi2: f64, degrees_of_freedom: i32) -> Fit {
    Fit {
        frame: "canonical".into(),
        free_rotations: 3,
        covariance: "exact".into(),
        onsets: degrees_of_freedom + 10,
        unknowns: 10,
        chi2,
        degrees_of_freedom,
        misfit: 1.0,
        widened: vec![1.0; ONSET_KINDS.len()],
        log_likelihood: -0.5 * chi2,
        ..Fit::default()
    }
}

fn context(fit: Fit) -> Context {
    Context { is_from_onsets: true, fits: vec![fit], ..Context::default() }
}

fn decisions(context: &Context) -> Vec<Decision> {
    let patch = Patch { patch: 1, kind: "visible".into(), y_m: 1.0, onsets: 1, ..Patch::default() };
    Conclude {}.apply(context, vec![patch]).expect("it computes nothing").rows
}

#[test]
fn a_place_that_later_bounces_decide_is_a_decision() {
    let scene = SceneOdds { alternative: 1, patches: vec![4], taken: true, log_likelihood: -9.0 };
    let rows = decisions(&Context { scenes: vec![scene], ..context(fit(50.0, 50)) });
    let place = rows.iter().find(|row| &*row.what == "place: patch 4").expect("each place is a decision");
    assert_eq!((&*place.chosen, place.log_likelihood_ratio), ("alternative 1", Some(9.0)));
    assert_eq!(place.runner_up.as_deref(), Some("the likeliest place by first light"));
}

/// What `refine` says of the fit is the first row.
#[test]
fn a_fit_that_is_not_explained_says_how_much_larger_its_errors_are() {
    let chosen = |fit: Fit| decisions(&context(fit))[0].chosen.to_string();
    assert_eq!(chosen(fit(80.0, 50)), "explained");
    assert_eq!(chosen(fit(300.0, 50)), "explained but for the onsets that `suspects` lists");
    let misfit = Fit { misfit: 4.0, ..fit(200.0, 50) };
    assert_eq!(chosen(misfit), "not explained: the program widened standard deviations, 2.0 times for all");
    let later = Fit { widened: vec![1.0, 1.0, 9.0, 1.0], ..fit(50.0, 50) };
    assert_eq!(chosen(later), "not explained: the program widened standard deviations, 3.0 times for later bounces");
    assert_eq!(chosen(fit(0.0, 0)), "unchecked");
}

/// A drift is a row of its own; without one there is none.
#[test]
fn a_drift_is_said_with_its_evidence() {
    let steady = decisions(&context(fit(50.0, 50)));
    assert!(steady.iter().all(|row| &*row.what != "drift of the delays"));
    let drift =
        Fit { drift_ps: Some(21.04), drift_span_s: Some(86_400.0), drift_log_likelihood: Some(85.0), ..fit(50.0, 50) };
    let rows = decisions(&context(drift));
    assert_eq!((&*rows[1].what, &*rows[1].chosen), ("drift of the delays", "times drift by 21.0 ps within 24.0 h"));
    assert_eq!(rows[1].log_likelihood_ratio, Some(85.0));
}

/// Another solution stands with its likelihood, as `ambiguities` has it, and points to its rows in `patches`.
#[test]
fn other_solutions_keep_their_likelihood() {
    let mut context = context(fit(50.0, 50));
    context.ambiguities = vec![Ambiguity {
        kind: "flip".into(),
        patches: vec![4],
        alternative: Some(1),
        log_likelihood: Some(-2.0),
        sd_m: None,
        meaning: "pair 4 with 7".into(),
    }];
    let rows = decisions(&context);
    let flip = rows.iter().find(|row| &*row.what == "flip: patch 4").expect("each ambiguity is a decision");
    assert_eq!(flip.log_likelihood_ratio, Some(2.0));
    assert_eq!(flip.runner_up.as_deref(), Some("alternative 1 of `patches`"));
    assert_eq!(&*flip.would_change, "pair 4 with 7");
    assert_eq!(&*flip.evidence, "the other solution is less likely by a factor of 7.4");
    context.ambiguities[0].log_likelihood = Some(4e-11);
    let rows = decisions(&context);
    assert!(rows.iter().any(|row| &*row.evidence == "the other solution is as likely"));
}

/// The numbers are those of the rows, from 1.
#[test]
fn decisions_are_numbered() {
    let rows = decisions(&context(fit(50.0, 50)));
    assert!(rows.iter().zip(1..).all(|(row, number)| row.decision == number));
}

/// A relay wall has no fit of onsets: its first row is the verdict, and nothing speaks of labels.
#[test]
fn the_verdict_of_a_relay_wall_comes_first() {
    let search = |verdict: &str, reappear| JointSearch {
        verdict: verdict.into(),
        reason: "24 points would be needed".into(),
        histograms: 64,
        points: 3,
        reappear,
        response: "wall".into(),
        gate_ps: 526.4,
        end_ps: 4000.0,
        threshold: 5.5,
        largest: 80.0,
        ..JointSearch::default()
    };
    let image = Image {
        method: "light-cone".into(),
        voxels: 7,
        threshold: 6.2,
        cells: 1000,
        largest: Some(60.0),
        largest_x_m: Some(0.1),
        largest_y_m: Some(0.2),
        largest_z_m: Some(0.635),
        ..Image::default()
    };
    let of = |search| decisions(&Context { searches: vec![search], images: vec![image.clone()], ..Context::default() });
    let rows = of(search("extended-object", None));
    let what: Vec<&str> = rows.iter().map(|row| &*row.what).collect();
    assert_eq!(what, ["hidden things", "image", "response", "gate"]);
    assert!(rows[0].chosen.contains("extended object") && rows[0].evidence.contains("24 points"), "{rows:?}");
    assert!(rows[1].evidence.contains("0.635") && rows[3].chosen.contains("526 ps"), "{rows:?}");
    let chosen = |verdict: &str| of(search(verdict, Some(1.0)))[0].chosen.to_string();
    assert!(
        chosen("points").starts_with("3 points with error bars") && chosen("cannot-tell").starts_with("undetermined")
    );
    assert_eq!(chosen("nothing"), "nothing");
}

/// First light is asked only where points do not explain what is seen.
#[test]
fn the_surface_of_an_extended_object_follows_its_verdict() {
    let of = |verdict: &str, points: usize| {
        let search = JointSearch { verdict: verdict.into(), ..JointSearch::default() };
        let point = SurfacePoint { kind: "smooth".into(), sd_m: 0.002, ..SurfacePoint::default() };
        let surface = Some(vec![point; points]);
        let omissions = vec![Omission { reason: "no-rise".into(), ..Omission::default() }; 2];
        let rows = decisions(&Context { searches: vec![search], surface, omissions, ..Context::default() });
        rows.into_iter().find(|row| &*row.what == "surface")
    };
    let row = of("extended-object", 3).expect("an extended object has a surface");
    assert!(row.chosen.starts_with("3 points") && row.evidence.contains("3 smooth") && row.evidence.contains("2.0 mm"));
    assert!(
        row.evidence.ends_with("without a point of first light, in `surface.omissions`: 2 with no light that rises"),
        "{row:?}"
    );
    assert!(of("extended-object", 0).is_some_and(|row| row.chosen.starts_with("no surface")));
    assert_eq!(of("points", 3), None);
}

/// What points lie on is told beside them, by name and radius.
#[test]
fn shapes_of_a_surface_are_named() {
    let of = |shapes: Vec<Shape>| {
        let search = JointSearch { verdict: "extended-object".into(), ..JointSearch::default() };
        let surface = Some(vec![SurfacePoint::default(); 90]);
        let context = Context { searches: vec![search], surface, shapes: Some(shapes), ..Context::default() };
        decisions(&context).into_iter().find(|row| &*row.what == "shapes").expect("a row of shapes")
    };
    let radius = |mm: f64| Some(1e-3 * mm);
    let sphere = Shape { kind: "sphere".into(), radius_m: radius(200.0), radius_sd_m: radius(1.5), ..Shape::default() };
    let plane = Shape { kind: "plane".into(), wall_points: 30, ..Shape::default() };
    let row = of(vec![Shape { wall_points: 50, ..sphere }, plane]);
    assert!(
        row.chosen.starts_with("sphere of radius 200.0 ± 1.5 mm, plane") && row.evidence.contains("80 of 90"),
        "{row:?}"
    );
    assert!(of(Vec::new()).chosen.starts_with("none"));
}

/// A weak patch has a row of its own and is not counted twice; less than even odds are no runner-up.
#[test]
fn weak_patches_stand_beside_hidden_ones() {
    let place = |patch, evidence| Hypothesis {
        kind: "patch".into(),
        patch,
        evidence,
        evidence_needed: 6.9,
        shots_needed: patch.is_none().then_some(300.0),
        ..Hypothesis::default()
    };
    let hidden = |patch| Patch { patch, kind: "hidden".into(), ..Patch::default() };
    let rows = |weak: Vec<Hypothesis>| {
        let context = Context { hypotheses: vec![place(Some(9), 50.0)], weak: Some(weak), ..context(fit(50.0, 50)) };
        Conclude {}.apply(&context, vec![hidden(9), hidden(10)]).unwrap().rows
    };
    let row = |rows: &[Decision], what: &str| rows.iter().find(|row| &*row.what == what).unwrap().clone();
    let both = rows(vec![place(Some(10), 12.0), place(None, -1.0)]);
    assert_eq!(&*row(&both, "hidden patches").chosen, "1 accepted");
    let weak = row(&both, "weak patches");
    assert!(&*weak.chosen == "1 accepted" && weak.runner_up.is_none() && weak.evidence.contains("12.0"), "{weak:?}");
    let declined = row(&rows(vec![place(None, 4.0)]), "weak patches");
    assert!(&*declined.chosen == "none" && declined.would_change.contains("300 shots"), "{declined:?}");
    assert!(declined.runner_up.is_some() && declined.evidence.contains("4.0 at the likeliest"), "{declined:?}");
}

/// Without a fit or a search there is nothing to conclude from.
#[test]
fn something_must_have_been_solved() {
    let refused = Conclude {}.context((), &BesideTables::from([]));
    assert!(matches!(refused, Err(StageError::Refused(text)) if text.contains("`searches` of `locate`")));
}

/// Echoes that `recalibrate` added have a row with their share; a response that stands has none.
#[test]
fn echoes_of_a_corrected_response_have_a_row() {
    let row = |sensor: &str, tail: Option<f64>| Calibration {
        sensor: sensor.into(),
        scene_tail: tail,
        scene_evidence: tail.map(|_| 40.0),
        ..Calibration::default()
    };
    let calibration = vec![row("s1", Some(0.004)), row("s2", None), row("s3", Some(-0.25))];
    let rows = decisions(&Context { calibration, ..context(fit(50.0, 50)) });
    let chosen = |what: &str| rows.iter().find(|row| &*row.what == what).map(|row| row.chosen.to_string());
    assert_eq!(
        chosen("echoes of s1").expect("a row"),
        "corrected: 0.40 % more light in echoes or a tail than calibrated"
    );
    assert!(chosen("echoes of s2").is_none());
    // So much is another response.
    let far = chosen("echoes of s3").expect("a row");
    assert!(far.starts_with("the calibration contradicts the scene") && far.contains("25.00 % less"), "{far}");
}

/// What onsets show of waveforms and response is told, one row a sensor.
#[test]
fn waveforms_and_responses_have_rows() {
    let onset = |seen: i32, flags: &[&str], width: f64| Onset {
        sensor: "s1".into(),
        lit: 1,
        seen,
        flags: flags.iter().map(|flag| Name::from(*flag)).collect(),
        response_width: Some(width),
        response_width_sd: Some(0.01),
        ..Onset::default()
    };
    let rows = |onsets: Vec<Onset>| decisions(&Context { onsets, ..context(fit(50.0, 50)) });
    let chosen = |rows: &[Decision], what: &str| {
        rows.iter().find(|row| &*row.what == what).map(|row| row.chosen.to_string()).expect("it has a row")
    };
    let good = rows((1..40).map(|seen| onset(seen, &[], 1.002)).collect());
    assert_eq!(chosen(&good, "waveforms"), "explained by pulses, noise and baseline");
    assert_eq!(chosen(&good, "response of s1"), "as wide as calibrated");
    let bad = rows((1..40).map(|seen| onset(seen, &["misfit"], 0.95)).collect());
    assert!(chosen(&bad, "waveforms").starts_with("not explained in 39 of 39 profiles"), "{bad:?}");
    assert!(chosen(&bad, "response of s1").contains("5.0 % narrower"), "{bad:?}");
}
