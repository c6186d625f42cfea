//! The report: what the page says, that it needs nothing but itself, and that a browser draws all of it.

mod in_browser;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use periscope::pipeline::run::Settings;
use periscope::report::{Report, figures, page};
use periscope::simulate::Format;
use periscope::tables::{
    Calibration, Decision, Distance, Fit, Impulse, Label, Onset, Patch, Profile, Residual, Row, Stir,
};

use crate::browser::Browser;
use crate::lab::{ALL_VISIBLE, AVERAGES, Lab, TINY, write_table};
use crate::scope_samples::samples;
use in_browser::is_drawn_whole;

/// The page of a small campaign is at most this large, and that of the largest.
const MOST_BYTES: usize = 8_000_000;
const MOST_BYTES_OF_ALL: usize = 15_000_000;

/// Around the corner: a small campaign with three hidden patches.
static CORNER: LazyLock<Lab> = LazyLock::new(|| {
    let lab = Lab::of(include_str!("../../pipelines/scenes/around-the-corner.toml"), 1, Format::Trc);
    let periscope = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["run", "scene", "--progress", "none"])
        .arg("--campaign")
        .arg(lab.campaign())
        .arg("--out")
        .arg(lab.path("out"))
        .output()
        .unwrap();
    assert_eq!(periscope.status.code(), Some(0), "{}", String::from_utf8_lossy(&periscope.stderr));
    lab
});

fn page_of(out: &Path) -> String {
    page::page(&Report::of(out).unwrap())
}

/// The page without the plotting library.
fn own(page: &str) -> String {
    let library = page.find("type=\"text/javascript\">").expect("the library is there");
    let end = library + page[library..].find("</script>").unwrap();
    page[..library].to_owned() + &page[end..]
}

#[test]
fn the_command_writes_one_file_that_needs_no_network() {
    let said = Command::new(env!("CARGO_BIN_EXE_periscope")).arg("report").arg(CORNER.path("out")).output().unwrap();
    assert_eq!(said.status.code(), Some(0), "{}", String::from_utf8_lossy(&said.stderr));
    let file = PathBuf::from(String::from_utf8(said.stdout).unwrap().trim_end());
    assert_eq!(file, CORNER.path("out").join("report.html"));
    let page = fs::read_to_string(file).unwrap();
    assert!(page.len() < MOST_BYTES, "{} bytes", page.len());
    let own = own(&page);
    // Only its own two scripts run, whatever a name in a table holds.
    let nonce = own.split("script-src 'nonce-").nth(1).and_then(|rest| rest.split('\'').next()).unwrap();
    assert_eq!(page.matches(&format!("<script nonce=\"{nonce}\"")).count(), 2);
    assert_eq!(page.matches(nonce).count(), 3, "in the policy and in the two scripts");
    for loads in ["src=", "@import", "url(", "<link", "http://", "https://", "fetch("] {
        assert!(!own.contains(loads), "{loads}");
    }
    assert!(own.contains("8 visible") && own.contains("3 hidden"), "the answer stands first");
    for section in [
        "decisions",
        "answer",
        "patches",
        "stir",
        "profiles",
        "response",
        "residuals",
        "distances",
        "rejects",
        "provenance",
    ] {
        assert!(own.contains(&format!("<section id=\"{section}\"")), "{section}");
    }
    // It is no table: the other commands do not trip over it.
    let tables = Command::new(env!("CARGO_BIN_EXE_periscope")).arg("verify").arg(CORNER.path("out")).output().unwrap();
    assert_eq!(tables.status.code(), Some(0), "{}", String::from_utf8_lossy(&tables.stdout));
}

#[test]
fn the_page_has_the_numbers_of_the_tables() {
    let own = own(&page_of(&CORNER.path("out")));
    for patch in CORNER.rows::<Patch>("out", "patches").iter().filter(|patch| patch.alternative == 0) {
        assert!(own.contains(&format!("<td>{:.5}</td>", patch.x_m)), "x of patch {}", patch.patch);
        let over: Vec<Residual> = CORNER.rows("out", "patches.residuals");
        let over = over.iter().filter(|row| row.path.contains(&patch.patch)).count();
        let summary = format!("Patch {} ({}): {over} onsets", patch.patch, patch.kind);
        assert!(own.contains(&summary), "{summary}");
    }
    let worst: Vec<Residual> = CORNER.rows("out", "patches.residuals");
    let pull = |row: &Residual| row.studentised.unwrap_or(row.standardised).abs();
    let worst = worst.iter().filter(|row| row.used).max_by(|a, b| pull(a).total_cmp(&pull(b))).unwrap();
    assert!(own.contains(&format!("s1, lit {}, seen {}, rank {}", worst.lit, worst.seen, worst.rank)));
}

#[test]
fn the_head_says_that_the_model_explains_the_data() {
    let own = own(&page_of(&CORNER.path("out")));
    let head = &own[own.find("id=\"verdict\"").unwrap()..own.find("<nav").unwrap()];
    assert!(head.contains("class=\"verdict well\"") && head.contains(" Explained</p>"), "{head}");
    // The numbers of the solution's own fit, not of one on the way to it.
    let fit = &CORNER.rows::<Fit>("out", "patches.fits")[0];
    let evidence = format!("chi-square {:.1} of {} degrees of freedom", fit.chi2, fit.degrees_of_freedom);
    assert!(head.contains(&evidence), "{head}");
    assert!(head.contains(&format!(", {} degrees of freedom), p-value", fit.degrees_of_freedom)), "{head}");
    assert!(head.contains("onsets without a path") && head.contains("href=\"#open\""), "{head}");
    let rows: Vec<Decision> = CORNER.rows("out", "decisions");
    let table = own.split("id=\"decisions\"").nth(1).unwrap().split("</section>").next().unwrap();
    assert!(rows.len() > 5 && table.matches("<tr>").count() == rows.len() + 1, "{table}");
}

/// Runs the usual pipeline of the command over a campaign of this lab.
fn run_scene(lab: &Lab, out: &str) -> i32 {
    let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
    command.args(["run", "--progress", "none", "--campaign"]).arg(lab.campaign()).arg("--out").arg(lab.path(out));
    command.output().unwrap().status.code().unwrap()
}

/// Captures with one response, a calibration with that of a slower sensor; the head of the report.
fn with_slower_calibration(tau_ps: f64) -> (String, String) {
    let lab = Lab::tiny();
    let slower = Lab::of(&TINY.replace("tau_ps = 112.0", &format!("tau_ps = {tau_ps:?}")), 1, Format::Trc);
    for name in ["s1_C1.trc", "s1_C2.trc"] {
        fs::copy(slower.campaign().join("raw/response").join(name), lab.campaign().join("raw/response").join(name))
            .unwrap();
    }
    assert_eq!(run_scene(&lab, "out"), 0);
    let own = own(&page_of(&lab.path("out")));
    let head = own[own.find("id=\"verdict\"").unwrap()..own.find("<nav").unwrap()].to_owned();
    (own, head)
}

#[test]
fn a_wrong_response_is_not_explained_at_first_sight() {
    let (own, head) = with_slower_calibration(220.0);
    assert!(head.contains("class=\"verdict bad\"") && head.contains(" Not explained</p>"), "{head}");
    assert!(head.contains("do not trust the positions") && head.contains("waveforms: not explained in"), "{head}");
    // What the waveforms leave is to be seen, too: residuals far beyond noise.
    let residuals = records(&own);
    let residuals = residuals.values().flat_map(|record| numbers(&record["residual"]));
    let largest = residuals.map(f64::abs).fold(0.0, f64::max);
    assert!(largest > 5.0, "{largest}");
}

/// `recalibrate` corrects enough of this one for the waveforms: the head names it all the same.
#[test]
fn a_response_that_the_scene_corrected_is_named_at_first_sight() {
    let (_, head) = with_slower_calibration(160.0);
    assert!(head.contains("class=\"verdict doubt\"") && head.contains(" Explained in part</p>"), "{head}");
    assert!(head.contains("response of s1: the calibration contradicts the scene"), "{head}");
    assert!(head.contains("echoes of s1: the calibration contradicts the scene"), "{head}");
}

#[test]
fn the_head_says_when_the_last_run_failed_and_the_page_how_the_answer_grew() {
    let lab = Lab::tiny();
    let (scene, aside) = (lab.campaign().join("raw/scene"), lab.path("aside"));
    fs::create_dir_all(&aside).unwrap();
    let names = ["s1_L1_P2_C1.trc", "s1_L1_P2_C2.trc"];
    names.iter().for_each(|name| fs::rename(scene.join(name), aside.join(name)).unwrap());
    assert_eq!(run_scene(&lab, "out"), 0);
    assert!(!own(&page_of(&lab.path("out"))).contains("id=\"growth\""), "one run is no growth");
    names.iter().for_each(|name| fs::rename(aside.join(name), scene.join(name)).unwrap());
    assert_eq!(run_scene(&lab, "out"), 0);
    let page = own(&page_of(&lab.path("out")));
    let growth = page.split("id=\"growth\"").nth(1).expect("two runs, two answers").split("</section>").next().unwrap();
    let shots = |profiles: usize| format!("<td>{profiles}</td>");
    assert!(
        growth.contains(&shots(15)) && growth.contains(&shots(16)) && growth.matches("<tr>").count() == 3,
        "{growth}"
    );
    fs::rename(lab.campaign().join("raw/response/s1_C1.trc"), aside.join("response.trc")).unwrap();
    assert_eq!(run_scene(&lab, "out"), 1);
    let page = own(&page_of(&lab.path("out")));
    let head = &page[page.find("id=\"verdict\"").unwrap()..page.find("<nav").unwrap()];
    assert!(head.contains("class=\"verdict bad\"") && head.contains(" The run failed</p>"), "{head}");
    assert!(head.contains("no file shows the impulse response of sensor"), "{head}");
    assert!(head.contains("what stands below is of earlier work"), "{head}");
    // A folder without tables claims nothing, and has no empty sections.
    assert_eq!(run_scene(&lab, "new"), 1);
    let page = own(&page_of(&lab.path("new")));
    let head = &page[page.find("id=\"verdict\"").unwrap()..page.find("</nav>").unwrap()];
    let claims = ["earlier work", "solves for positions", "left out", "href=\"#stir\""];
    assert!(claims.iter().all(|claim| !head.contains(claim)), "{head}");
    assert!(page.contains("This result folder has no table for: ") && page.contains("STIR"), "{page}");
}

/// Numbers of the profiles in a page, by address.
fn records(page: &str) -> serde_json::Map<String, serde_json::Value> {
    let json = page.split("id=\"profile-records\">").nth(1).unwrap().split("</script>").next().unwrap();
    serde_json::from_str(json).unwrap()
}

fn numbers(values: &serde_json::Value) -> Vec<f64> {
    values.as_array().unwrap().iter().filter_map(serde_json::Value::as_f64).collect()
}

/// Root mean square of values off the line through them that is nearest to all.
fn rms_off_a_line(x: &[f64], y: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (middle, level) = (mean(x), mean(y));
    let products: Vec<f64> = x.iter().zip(y).map(|(x, y)| (x - middle) * (y - level)).collect();
    let slope = mean(&products) / mean(&x.iter().map(|x| (x - middle).powi(2)).collect::<Vec<_>>());
    let left: Vec<f64> = x.iter().zip(y).map(|(x, y)| (y - level - slope * (x - middle)).powi(2)).collect();
    mean(&left).sqrt()
}

/// Straight lines between the samples of the calibration's response, added up at the times of `stir`, on the line that
/// fits best: the page's curve is the same but for what averaging over sub-sample phases does to an edge.
#[test]
fn fitted_curves_are_sums_of_responses_and_leave_noise() {
    let records = records(&own(&page_of(&CORNER.path("out"))));
    let calibration: Calibration = CORNER.rows("out", "calibration").remove(0);
    let response = |after_ps: f64| -> f64 {
        let place = (after_ps - calibration.response_t0_ps) / calibration.step_ps;
        let sample = |n: f64| calibration.response.get(n as usize).map_or(0.0, |value| f64::from(*value));
        if place < 0.0 {
            0.0
        } else {
            sample(place.floor()) * (1.0 - place.fract()) + sample(place.floor() + 1.0) * place.fract()
        }
    };
    let (mut compared, mut mean_squares) = (0, Vec::new());
    for row in CORNER.rows::<Stir>("out", "stir") {
        let record = &records[&format!("profile-around_the_corner-s1-{}-{}", row.lit, row.seen)];
        let [time, fit, mean, error, residual] =
            ["time", "fit", "mean", "error", "residual"].map(|name| numbers(&record[name]));
        for n in 0..time.len() {
            // Values in the page have four digits, errors two.
            let rounding = 0.06 * residual[n].abs() + 1.1e-3 * mean[n].abs() / error[n] + 0.02;
            let off = residual[n] - (mean[n] - fit[n]) / error[n];
            assert!(off.abs() < rounding, "{n}: off by {off}");
        }
        let chi2 = residual.iter().map(|value| value * value).sum::<f64>() / residual.len() as f64;
        mean_squares.push(chi2 / row.chi2_dof.unwrap());
        if row.impulses.iter().any(|impulse| impulse.tail_ps.is_some()) {
            continue;
        }
        // Widths by the rule of the rectangle.
        let spread = |time_ps: f64, impulse: &Impulse| -> f64 {
            let nodes = (-20..=20).map(|n| 0.2 * f64::from(n));
            let density = |sds: f64| 0.2 * (-0.5 * sds * sds).exp() / std::f64::consts::TAU.sqrt();
            nodes.map(|sds| density(sds) * response(time_ps - impulse.time_ps - sds * impulse.width_ps)).sum()
        };
        let naive = |time_ps: f64| -> f64 {
            row.impulses.iter().map(|impulse| impulse.amplitude_v * spread(time_ps, impulse)).sum()
        };
        let highest = row.impulses.iter().map(|impulse| impulse.amplitude_v).fold(0.0, f64::max);
        let off: Vec<f64> = time.iter().zip(&fit).map(|(time_ps, fit)| fit - naive(*time_ps)).collect();
        let rms = rms_off_a_line(&time, &off);
        assert!(rms < 0.03 * highest, "lit {}, seen {}: {rms} of {highest}", row.lit, row.seen);
        compared += 1;
    }
    assert!(compared >= 5, "{compared} profiles without a tail");
    // What the curves leave is what `deconvolve` found, which took the correlation of noise into account.
    mean_squares.sort_by(f64::total_cmp);
    let (least, median) = (mean_squares[0], mean_squares[mean_squares.len() / 2]);
    // A window around one pulse has few samples.
    assert!((0.85..1.2).contains(&median) && least > 0.25, "{mean_squares:?}");
    assert!(mean_squares[mean_squares.len() - 1] < 2.0, "{mean_squares:?}");
}

/// The row of the larger `lit` has no pulses: its curve has the times of the other row, and heights of its own.
#[test]
fn profiles_that_were_explained_together_have_a_curve_each() {
    let lab = Lab::tiny();
    lab.run_with("out", ALL_VISIBLE, &["stir.joint=true".to_owned()], &Settings::default()).unwrap();
    let records = records(&own(&page_of(&lab.path("out"))));
    let mut together = 0;
    for row in lab.rows::<Stir>("out", "stir") {
        let record = &records[&format!("profile-tiny-s1-{}-{}", row.lit, row.seen)];
        let residual = numbers(&record["residual"]);
        let chi2 = residual.iter().map(|value| value * value).sum::<f64>() / residual.len() as f64;
        assert!((0.2..2.0).contains(&chi2), "lit {}, seen {}: {chi2}", row.lit, row.seen);
        let note = format!("Fitted together with lit {}, seen {},", row.seen, row.lit);
        assert_eq!(record["note"].as_str().unwrap().contains(&note), row.chi2_dof.is_none(), "{record}");
        together += i32::from(row.chi2_dof.is_none());
    }
    assert_eq!(together, 6, "pairs of four patches");
}

#[test]
fn a_pipeline_that_solves_nothing_has_its_page_too() {
    let lab = Lab::bulk(2);
    lab.run("out", AVERAGES, &Settings::default()).unwrap();
    let own = own(&page_of(&lab.path("out")));
    assert!(
        own.contains("solves for positions") && own.contains("2 profiles") && own.contains("lit 1, seen 2"),
        "{own}"
    );
}

#[test]
fn figures_are_svg_with_something_in_it() {
    let figures = figures::all(&Report::of(&CORNER.path("out")).unwrap()).unwrap();
    let names: Vec<&str> = figures.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["scene", "stir", "distances", "profile", "response", "residuals"]);
    for (name, svg) in &figures {
        let mut reader = quick_xml::Reader::from_str(svg);
        let mut elements = 0;
        loop {
            match reader.read_event().unwrap_or_else(|error| panic!("{name}: {error}")) {
                quick_xml::events::Event::Eof => break,
                quick_xml::events::Event::Empty(_) | quick_xml::events::Event::Start(_) => elements += 1,
                _ => {}
            }
        }
        assert!(elements > 30 && !svg.contains("NaN"), "{name}: {elements} elements");
        assert!(svg.len() < 1_500_000, "{name}: {} bytes", svg.len());
    }
}

/// 500 patches, all of them in one another's sight; the profiles of 20,000 pairs.
fn five_hundred(lab: &Lab) -> PathBuf {
    const PATCHES: i32 = 500;
    let profile: Profile = lab.rows("out", "profiles").into_iter().find(|row: &Profile| &*row.role == "scene").unwrap();
    let stir: Stir = lab.rows("out", "stir").remove(0);
    let patch: Patch = lab.rows("out", "patches").remove(0);
    let onset: Onset = lab.rows("out", "onsets").remove(0);
    let label: Label = lab.rows("out", "labels").remove(0);
    let distance: Distance = lab.rows("out", "distances").remove(0);
    let pairs = || (1..=PATCHES).flat_map(|lit| (1..=PATCHES).map(move |seen| (lit, seen)));
    let near = || pairs().filter(|(lit, seen)| (seen - lit).rem_euclid(PATCHES) < 40);
    let wave = |n: i32| f64::from(n * 7919 % 1000) / 1000.0;
    let folder = lab.path("five-hundred");
    fs::create_dir_all(&folder).unwrap();
    let patches: Vec<Patch> = (1..=PATCHES)
        .map(|n| Patch {
            patch: n,
            x_m: f64::from(n % 25) * 0.1,
            y_m: 1.0 + wave(n),
            z_m: f64::from(n / 25) * 0.1,
            ..patch.clone()
        })
        .collect();
    let labels: Vec<Label> = pairs()
        .map(|(lit, seen)| Label {
            lit,
            seen,
            rank: 1,
            part: 0,
            path: Some(vec![lit, seen]),
            bounces: 2,
            residual_ps: Some(wave(lit + seen) - 0.5),
            time_sd_ps: 0.3,
            alternative: 0,
            ..label.clone()
        })
        .collect();
    let onsets: Vec<Onset> = pairs()
        .map(|(lit, seen)| Onset {
            lit,
            seen,
            rank: 1,
            time_ps: 7000.0 + 100.0 * wave(lit * seen % 9973),
            covariance: vec![0.1],
            ..onset.clone()
        })
        .collect();
    let distances: Vec<Distance> = pairs()
        .filter(|(a, b)| a < b)
        .map(|(a, b)| Distance { a, b, distance_m: 1.0 + wave(a + b), ..distance.clone() })
        .collect();
    let profiles: Vec<Profile> = near().map(|(lit, seen)| Profile { lit, seen, ..profile.clone() }).collect();
    let stirs: Vec<Stir> = near().map(|(lit, seen)| Stir { lit, seen, ..stir.clone() }).collect();
    let mut pipeline = String::new();
    let mut import = |table: &str| {
        let path = folder.join(format!("{table}.parquet"));
        let params = format!("{{ table = '{table}', path = '{}' }}", path.display());
        writeln!(pipeline, "[{table}]\nstage = 'import'\nparams = {params}").unwrap();
        path
    };
    write_table(&import(Patch::TABLE), &patches);
    write_table(&import(Label::TABLE), &labels);
    write_table(&import(Onset::TABLE), &onsets);
    write_table(&import(Distance::TABLE), &distances);
    write_table(&import(Profile::TABLE), &profiles);
    write_table(&import(Stir::TABLE), &stirs);
    lab.run("large", &pipeline, &Settings::default()).unwrap();
    lab.path("large")
}

/// Reflections on a line: real recordings, no positions.
#[test]
fn real_recordings_have_their_page() {
    let Some(samples) = samples() else { return };
    let folder = tempfile::tempdir().unwrap();
    let raw = folder.path().join("campaign/raw");
    fs::create_dir_all(&raw).unwrap();
    for name in ["campaign.toml", "captures.csv"] {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/campaigns/tdr").join(name);
        fs::copy(source, folder.path().join("campaign").join(name)).unwrap();
    }
    for entry in fs::read_dir(samples.join("campaign-tdr")).unwrap().flatten() {
        fs::copy(entry.path(), raw.join(entry.file_name())).unwrap();
    }
    let run = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args([
            "run",
            concat!(env!("CARGO_MANIFEST_DIR"), "/pipelines/tdr.toml"),
            "--campaign",
            "campaign",
            "--out",
            "out",
        ])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    let page = page_of(&folder.path().join("out"));
    assert!(own(&page).contains("264 onsets in 130 profiles"));
    let Some(browser) = Browser::open() else { return };
    let file = folder.path().join("tdr.html");
    fs::write(&file, page).unwrap();
    is_drawn_whole(&browser, &file);
}

#[test]
fn five_hundred_patches_stay_a_page() {
    let out = five_hundred(&CORNER);
    let page = page_of(&out);
    eprintln!("500 patches: {} bytes", page.len());
    assert!(page.len() < MOST_BYTES_OF_ALL, "{} bytes", page.len());
    assert!(own(&page).contains("Positions of 500 patches"));
    let Some(browser) = Browser::open() else { return };
    let file = CORNER.path("large.html");
    fs::write(&file, page).unwrap();
    is_drawn_whole(&browser, &file);
}
