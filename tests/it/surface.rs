//! Planes through patches of someone else's making.

use periscope::pipeline::run::Settings;
use periscope::pipeline::spec::Spec;
use periscope::tables::{Patch, PatchCovariance, Plane, Reject};

use crate::lab::{Lab, write_table};

/// Twelve patches: seven on a wall 2 m away, five on a floor 1 m below, each known to 1 mm and 0.5 mm off at most.
fn patches() -> Vec<Patch> {
    let wall = [(-1.0, -0.5), (-0.2, -0.4), (0.5, -0.6), (-0.9, 0.4), (0.1, 0.5), (0.8, 0.3), (0.2, 0.0)];
    let floor = [(-0.8, 0.5), (0.7, 0.6), (-0.5, 1.4), (0.6, 1.5), (0.1, 1.0)];
    let off = |n: usize| 0.0005 * [1.0, -1.0, 0.5][n % 3];
    let on_wall = wall.iter().enumerate().map(|(n, (x, z))| [*x, 2.0 + off(n), *z]);
    let on_floor = floor.iter().enumerate().map(|(n, (x, y))| [*x, *y, off(n) - 1.0]);
    let row = |(n, [x_m, y_m, z_m]): (usize, [f64; 3])| Patch {
        patch: n as i32 + 1,
        kind: "visible".into(),
        x_m,
        y_m,
        z_m,
        cov_xx_m2: Some(1e-6),
        cov_xy_m2: Some(0.0),
        cov_xz_m2: Some(0.0),
        cov_yy_m2: Some(1e-6),
        cov_yz_m2: Some(0.0),
        cov_zz_m2: Some(1e-6),
        sd_m: Some(3e-6_f64.sqrt()),
        onsets: 1,
        ..Patch::default()
    };
    on_wall.chain(on_floor).enumerate().map(row).collect()
}

#[test]
fn planes_of_imported_patches() {
    let lab = Lab::bulk(0);
    let import = |table: &str| {
        format!(
            "stage = 'import'\nparams = {{ table = '{table}', path = {:?} }}\n",
            lab.path(&format!("{table}.parquet"))
        )
    };
    let pipeline = format!(
        "[patches]\n{}[covariances]\n{}[planes]\nstage = 'surface'\nfrom = 'patches'\nwith = {{ covariances = 'covariances' }}\n",
        import("patches"),
        import("patch_covariances")
    );
    let mut rows = patches();
    rows[4].cov_xx_m2 = None;
    write_table(&lab.path("patches.parquet"), &rows);
    write_table::<PatchCovariance>(&lab.path("patch_covariances.parquet"), &[]);
    lab.run("out", &pipeline, &Settings::default()).unwrap();
    let planes: Vec<Plane> = lab.rows("out", "planes");
    assert_eq!(
        planes.iter().map(|plane| plane.patches.clone()).collect::<Vec<_>>(),
        [vec![1, 2, 3, 4, 6, 7], (8..=12).collect::<Vec<i32>>(),]
    );
    assert!((planes[0].normal_y - 1.0).abs() < 1e-4 && (planes[0].offset_m - 2.0).abs() < 0.001, "{:?}", planes[0]);
    assert!((planes[1].normal_z + 1.0).abs() < 1e-4 && (planes[1].offset_m - 1.0).abs() < 0.001, "{:?}", planes[1]);
    let (tilt_rad, sd_rad) = (planes[1].tilt_rad.unwrap(), planes[1].tilt_sd_rad.unwrap());
    assert!((tilt_rad - std::f64::consts::FRAC_PI_2).abs() < 3.0 * sd_rad && sd_rad < 0.003, "{tilt_rad} {sd_rad}");
    let rejects: Vec<Reject> = lab.rows("out", "rejects");
    assert!(rejects.len() == 1 && rejects[0].reason.contains("patch 5 has no covariance"), "{rejects:?}");
    assert_eq!((&*rejects[0].stage, &*rejects[0].campaign), ("planes", "bulk"));
    let by_hand = ["planes.groups=[[1, 2, 3], [8, 9, 10, 11]]".to_owned()];
    lab.run_with("by-hand", &pipeline, &by_hand, &Settings::default()).unwrap();
    assert_eq!(
        lab.rows::<Plane>("by-hand", "planes").iter().map(|plane| plane.patches.len()).collect::<Vec<_>>(),
        [3, 4]
    );
    let refused = Spec::parse("p", &pipeline, &["planes.least=3".to_owned()]).err().unwrap().to_string();
    assert!(refused.contains("[planes]: params.least = 3: must be a whole number from 4"), "{refused}");
}
