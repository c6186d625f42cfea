use super::*;

/// Six patches on the wall y = 2 m and four on the wall x = 1.2 m; the laser is at the origin.
fn walls() -> Vec<Point> {
    let back = [(-1.0, -0.5), (-0.3, 0.6), (0.5, -0.4), (0.9, 0.5), (-0.8, 0.2), (0.1, 0.0)]
        .map(|(x, z)| Point::new(x, 2.0, z));
    let side = [(0.6, -0.5), (1.5, 0.6), (0.9, 0.4), (1.4, -0.3)].map(|(y, z)| Point::new(1.2, y, z));
    back.into_iter().chain(side).collect()
}

/// As `refine` writes them: patches 1, 2...
fn patches(points: &[Point]) -> Vec<Patch> {
    let row = |(n, point): (usize, &Point)| {
        let row = start(n as PatchId + 1, "visible", *point, 7);
        Patch { cov_xx_m2: Some(1e-6), cov_xy_m2: Some(2e-7), sd_m: Some(0.001), log_likelihood: Some(-3.0), ..row }
    };
    points.iter().enumerate().map(row).collect()
}

fn context(dimensions: u8, given: Option<Vec<Patch>>) -> Context {
    let frame = Frame { dimensions, source_m: [0.0; 3], anchors_m: BTreeMap::new() };
    Context { campaign: "c".to_owned(), frame, patches: given, hypotheses: Vec::new(), cancel: Cancel::never() }
}

/// Distances of a hidden patch to known ones.
fn ranges(hidden: PatchId, at: Point, points: &[Point], to: &[PatchId]) -> Vec<Distance> {
    let range = |&patch: &PatchId| Distance {
        a: patch,
        b: hidden,
        distance_m: (points[patch as usize - 1] - at).norm(),
        sd_m: 0.001,
        bounces: 3,
        onsets: 2,
    };
    to.iter().map(range).collect()
}

fn point(row: &Patch) -> Point {
    Point::new(row.x_m, row.y_m, row.z_m)
}

#[test]
fn known_patches_are_passed_on_and_hidden_ones_placed_from_their_distances() {
    let (points, truth) = (walls(), [Point::new(0.2, 0.9, 0.3), Point::new(-0.4, 1.3, -0.6)]);
    let patches = patches(&points);
    let mut distances = ranges(21, truth[0], &points, &[1, 3, 4, 7, 8]);
    distances.extend(ranges(22, truth[1], &points, &[2, 3, 5, 6, 9, 10]));
    distances.extend(ranges(23, truth[1], &points, &[2, 8]));
    let outcome = Embed::default().apply(&context(3, Some(patches.clone())), distances).unwrap();
    assert_eq!(outcome.rows[..10], patches);
    let [a, b] = &outcome.rows[10..] else { panic!("{:?}", &outcome.rows[10..]) };
    for (row, (patch, truth)) in [a, b].into_iter().zip([(21, truth[0]), (22, truth[1])]) {
        assert_eq!((row.patch, &*row.kind, row.alternative, row.cov_xx_m2), (patch, "hidden", 0, None));
        assert!((point(row) - truth).norm() < 1e-6);
    }
    let [left_out] = &outcome.rejections[..] else { panic!("{:?}", outcome.rejections) };
    assert!(left_out.reason.contains("patch 23 has distances to 2 patches in known places (2, 8), too few"));
}

/// The wall alone leaves two places; the one on the laser's side is chosen.
#[test]
fn a_wall_leaves_a_mirror_image_which_is_reported() {
    let (points, truth) = (walls(), Point::new(0.3, 1.2, 0.1));
    let mirrored = Point::new(0.3, 2.8, 0.1);
    let mut patches = patches(&points);
    patches.push(Patch { alternative: 2, ..patches[3].clone() });
    for at in [truth, mirrored] {
        let distances = ranges(21, at, &points, &[1, 2, 3, 4, 5]);
        let outcome = Embed::default().apply(&context(3, Some(patches.clone())), distances).unwrap();
        let [chosen, other] = &outcome.rows[11..] else { panic!("{:?}", &outcome.rows[11..]) };
        assert!((point(chosen) - truth).norm() < 1e-6 && (point(other) - mirrored).norm() < 1e-6);
        assert_eq!(
            (chosen.alternative, chosen.log_likelihood, other.alternative, &*other.kind),
            (0, None, 3, "hidden")
        );
        assert!(other.log_likelihood.unwrap().abs() < 1e-6);
    }
    // In line, they leave a circle.
    let line: Vec<Point> = (0..4).map(|n| Point::new(0.3 * f64::from(n), 2.0, 0.0)).collect();
    let distances = ranges(21, truth, &line, &[1, 2, 3, 4]);
    let outcome = Embed::default().apply(&context(3, Some(self::patches(&line))), distances).unwrap();
    assert_eq!(outcome.rows.len(), 4);
    assert!(outcome.rejections[0].reason.contains("these lie in line"), "{:?}", outcome.rejections);
}

#[test]
fn in_flatland_a_line_leaves_a_mirror_image_and_two_lines_none() {
    let points: Vec<Point> = walls().into_iter().map(|point| Point::new(point.x, point.y, 0.0)).collect();
    let truth = Point::new(-0.2, 0.8, 0.0);
    let placed = |to: &[PatchId]| {
        let outcome =
            Embed::default().apply(&context(2, Some(patches(&points))), ranges(21, truth, &points, to)).unwrap();
        outcome.rows[10..].iter().map(point).collect::<Vec<Point>>()
    };
    for to in [[1, 4].as_slice(), &[1, 2, 3]] {
        let [chosen, other] = placed(to)[..] else { panic!("{:?}", placed(to)) };
        assert!((chosen - truth).norm() < 1e-6 && (other - Point::new(-0.2, 3.2, 0.0)).norm() < 1e-6);
    }
    let [only] = placed(&[1, 4, 7, 9])[..] else { panic!("{:?}", placed(&[1, 4, 7, 9])) };
    assert!((only - truth).norm() < 1e-6);
}

#[test]
fn without_known_patches_the_visible_are_embedded_first() {
    let (points, truth) = (walls(), Point::new(0.2, 0.9, 0.3));
    let all = [vec![Point::origin()], points.clone()].concat();
    let distance = |a: usize, b: usize| Distance {
        a: a as PatchId,
        b: b as PatchId,
        distance_m: (all[a] - all[b]).norm(),
        sd_m: 0.001,
        bounces: if a == 0 { 1 } else { 2 },
        onsets: 1,
    };
    let distance = &distance;
    let mut distances: Vec<Distance> = (1..=10).flat_map(|b| (0..b).map(move |a| distance(a, b))).collect();
    let seen = ranges(21, truth, &points, &[1, 3, 4, 7, 8, 10]);
    for method in [Method::Classical, Method::Incremental] {
        let embed = Embed { method };
        let visible = embed.apply(&context(3, None), distances.clone()).unwrap();
        let both = embed.apply(&context(3, None), [distances.clone(), seen.clone()].concat()).unwrap();
        assert_eq!(both.rows[..10], visible.rows);
        let [hidden] = &both.rows[10..] else { panic!("{:?}", &both.rows[10..]) };
        assert_eq!((hidden.patch, &*hidden.kind, hidden.onsets), (21, "hidden", 12));
        for range in &seen {
            let found_m = (point(hidden) - point(&both.rows[range.a as usize - 1])).norm();
            assert!((found_m - range.distance_m).abs() < 1e-6);
        }
    }
    // A patch with a first bounce is visible, whatever else it has.
    distances.retain(|distance| distance.b < 10);
    distances.push(distance(0, 10));
    distances.extend([3, 4, 7].map(|a| distance(a, 10)));
    let outcome = Embed::default().apply(&context(3, Some(patches(&points[..9]))), distances).unwrap();
    let last = outcome.rows.iter().find(|row| row.patch == 10).unwrap();
    assert!(&*last.kind == "visible" && (point(last) - points[9]).norm() < 1e-6, "{last:?}");
}

/// A patch without distances stands where `label` has it, with its mirror image as alternative; one with distances
/// where these have it.
#[test]
fn hypotheses_place_what_distances_do_not() {
    let (points, truth) = (walls(), Point::new(0.3, 1.2, 0.1));
    let hypothesis = |patch: PatchId, alternative: i32, x_m: f64| Hypothesis {
        kind: "patch".into(),
        hypothesis: 1,
        layer: 2,
        patch: Some(patch),
        alternative,
        x_m,
        y_m: 0.5,
        z_m: 0.2,
        cov_xx_m2: 1e-6,
        cov_yy_m2: 1e-6,
        cov_zz_m2: 1e-6,
        sd_m: 1.7e-3,
        evidence: 20.0 - f64::from(alternative),
        evidence_needed: 7.0,
        seen: 0.8,
        onsets: 40.2,
        ..Hypothesis::default()
    };
    let hypotheses = vec![hypothesis(21, 0, -3.0), hypothesis(22, 0, -1.0), hypothesis(22, 1, -2.0)];
    let context = Context { hypotheses, ..context(3, Some(patches(&points))) };
    let all: Vec<PatchId> = (1..=10).collect();
    let outcome = Embed::default().apply(&context, ranges(21, truth, &points, &all)).unwrap();
    let [first, second, other] = &outcome.rows[10..] else { panic!("{:?}", &outcome.rows[10..]) };
    assert!((point(first) - truth).norm() < 1e-6 && first.patch == 21, "{first:?}");
    assert_eq!((second.patch, second.x_m, second.onsets, &*second.kind), (22, -1.0, 40, "hidden"));
    assert_eq!((other.patch, other.x_m, other.log_likelihood), (22, -2.0, Some(-1.0)));
}

/// First light left its place open; later light shows it.
#[test]
fn a_visible_patch_that_later_light_shows_stands_there() {
    let points = walls();
    let mut given = patches(&points);
    given[3] = Patch { sd_m: None, cov_xx_m2: None, x_m: 5.0, ..given[3].clone() };
    given.push(Patch { alternative: 1, x_m: 6.0, ..given[3].clone() });
    let hypothesis = Hypothesis {
        kind: "patch".into(),
        layer: 1,
        patch: Some(4),
        x_m: points[3].x,
        y_m: points[3].y,
        z_m: points[3].z,
        onsets: 9.0,
        ..Hypothesis::default()
    };
    let context = Context { hypotheses: vec![hypothesis], ..context(3, Some(given)) };
    // Few distances, which leave a circle.
    let rows = Embed::default().apply(&context, ranges(4, points[3], &points, &[1, 2])).unwrap().rows;
    assert_eq!(rows.len(), 10);
    let of_four: Vec<&Patch> = rows.iter().filter(|row| row.patch == 4).collect();
    let [row] = of_four[..] else { panic!("{of_four:?}") };
    assert_eq!((&*row.kind, row.alternative), ("visible", 0));
    assert!((point(row) - points[3]).norm() < 1e-9, "{row:?}");
}
