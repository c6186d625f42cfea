use super::*;

fn fit(chi2: f64, degrees_of_freedom: i32) -> Fit {
    Fit {
        alternative: 0,
        frame: "canonical".into(),
        free_rotations: 3,
        covariance: "exact".into(),
        onsets: degrees_of_freedom + 10,
        unknowns: 10,
        chi2,
        degrees_of_freedom,
        log_likelihood: -0.5 * chi2,
        repetition_ps: None,
        repetition_sd_ps: None,
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
        scenes: Vec::new(),
    }
}

fn decisions(context: &Context) -> Vec<Decision> {
    let patch = Patch {
        patch: 1,
        kind: "visible".into(),
        x_m: 0.0,
        y_m: 1.0,
        z_m: 0.0,
        cov_xx_m2: None,
        cov_xy_m2: None,
        cov_xz_m2: None,
        cov_yy_m2: None,
        cov_yz_m2: None,
        cov_zz_m2: None,
        sd_m: None,
        onsets: 1,
        chi2_dof: None,
        alternative: 0,
        log_likelihood: None,
        probability: None,
    };
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

/// A right model exceeds the limit once in some 10,000 campaigns.
#[test]
fn a_fit_far_above_its_degrees_of_freedom_is_not_explained() {
    let chosen = |chi2| decisions(&context(fit(chi2, 50)))[0].chosen.to_string();
    assert_eq!(chosen(50.0 + 3.9 * 10.0), "explained");
    assert_eq!(chosen(50.0 + 4.1 * 10.0), "not explained: standard deviations are too small");
    assert_eq!(decisions(&context(fit(0.0, 0)))[0].chosen.to_string(), "unchecked");
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
