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
    Context {
        fits: vec![fit],
        ambiguities: Vec::new(),
        labels: Vec::new(),
        hypotheses: Vec::new(),
        onsets: Vec::new(),
        planes: Vec::new(),
        footprints: Vec::new(),
        scenes: Vec::new(),
    }
}

fn decisions(context: &Context) -> Vec<Decision> {
    let patch = Patch { patch: 1, kind: "visible".into(), y_m: 1.0, onsets: 1, ..Patch::default() };
    Conclude {}.apply(context, vec![patch]).expect("it computes nothing").rows
}

#[test]
fn a_place_that_later_bounces_decide_is_a_decision() {
    let scene = SceneOdds { alternative: 1, patches: vec![4], taken: true, log_likelihood: -9.0 };
    let rows = decisions(&Context { scenes: vec![scene], ..context(fit(50.0, 50)) });
    let place = rows.iter().find(|row| &*row.what == "place: patches 4").expect("each place is a decision");
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
    assert_eq!(chosen(misfit), "not explained: standard deviations are larger for it, 2.0 times for all");
    let later = Fit { widened: vec![1.0, 1.0, 9.0, 1.0], ..fit(50.0, 50) };
    assert_eq!(chosen(later), "not explained: standard deviations are larger for it, 3.0 times for later bounces");
    assert_eq!(chosen(fit(0.0, 0)), "unchecked");
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
    let flip = rows.iter().find(|row| &*row.what == "flip: patches 4").expect("each ambiguity is a decision");
    assert_eq!(flip.log_likelihood_ratio, Some(2.0));
    assert_eq!(flip.runner_up.as_deref(), Some("alternative 1 of `patches`"));
    assert_eq!(&*flip.would_change, "pair 4 with 7");
}

/// The numbers are those of the rows, from 1.
#[test]
fn decisions_are_numbered() {
    let rows = decisions(&context(fit(50.0, 50)));
    assert!(rows.iter().zip(1..).all(|(row, number)| row.decision == number));
}
