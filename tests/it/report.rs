//! The report: what the page says, that it needs nothing but itself, and that a browser draws all of it.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use periscope::pipeline::run::Settings;
use periscope::report::{Report, figures, page};
use periscope::simulate::Format;
use periscope::tables::{Distance, Label, Onset, Patch, Profile, Residual, Row, Stir};

use crate::browser::Browser;
use crate::lab::{AVERAGES, Lab, write_table};
use crate::scope_samples::samples;

/// A page is at most this large.
const MOST_BYTES: usize = 15_000_000;
/// Something stands on the screen within this time.
const FIRST_PAINT_MS: f64 = 2000.0;

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
    for section in
        ["answer", "patches", "stir", "profiles", "response", "residuals", "distances", "rejects", "provenance"]
    {
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
fn a_pipeline_that_solves_nothing_has_its_page_too() {
    let lab = Lab::bulk(2);
    lab.run("out", AVERAGES, &Settings::default()).unwrap();
    let own = own(&page_of(&lab.path("out")));
    assert!(
        own.contains("solved for positions") && own.contains("2 profiles") && own.contains("lit 1, seen 2"),
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

/// Opens a page, brings each plot into view, and waits until it is drawn.
fn is_drawn_whole(browser: &Browser, file: &Path) {
    browser.visit(file, "");
    browser.wait("first paint", "performance.getEntriesByName('first-contentful-paint').length");
    let paint_ms = browser.run("return performance.getEntriesByName('first-contentful-paint')[0].startTime;");
    eprintln!("{}: first paint after {paint_ms} ms", file.display());
    assert!(paint_ms.as_f64().unwrap() < FIRST_PAINT_MS, "{}: {paint_ms} ms", file.display());
    let plots = browser.run("return [...document.querySelectorAll('.plot')].map(plot => plot.id);");
    let plots = plots.as_array().unwrap();
    assert!(!plots.is_empty());
    for plot in plots.iter().map(|plot| plot.as_str().unwrap()) {
        browser.run(&format!("document.getElementById('{plot}').scrollIntoView();"));
        let is_there = format!("document.querySelector('#{plot} .main-svg, #{plot} canvas')");
        browser.wait(&format!("plot {plot} of {}", file.display()), &is_there);
    }
    let errors = browser.errors();
    assert!(errors.is_empty(), "{}: {errors:#?}", file.display());
    let sideways = browser.run("return document.documentElement.scrollWidth - innerWidth;");
    assert!(sideways.as_i64() <= Some(0), "{} is wider than its window by {sideways}", file.display());
}

#[test]
fn a_browser_draws_all_of_it_and_leads_from_patch_to_onset_to_profile() {
    let Some(browser) = Browser::open() else { return };
    let file = CORNER.path("corner.html");
    fs::write(&file, page_of(&CORNER.path("out"))).unwrap();
    is_drawn_whole(&browser, &file);
    browser.visit(&file, "#patch-9");
    browser.wait("the list of patch 9", "document.getElementById('patch-9').open");
    let profile = browser.run("const link = document.querySelector('#patch-9 a[href^=\"#profile-\"]'); link.click(); return link.hash.slice(1);");
    let shown = format!("document.getElementById('profile-choice').value === {profile}");
    browser.wait("the profile of its first onset", &shown);
    browser.wait("its curve", "document.getElementById('profile').data?.length > 3");
    let scale = "document.getElementById('profile').layout.yaxis.type";
    let before = browser.run(&format!("return {scale};"));
    browser.run("document.getElementById('profile-scale').click();");
    browser.wait("the other scale", &format!("{scale} !== {before}"));
    assert_eq!(browser.errors(), Vec::<String>::new());
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
    assert!(page.len() < MOST_BYTES, "{} bytes", page.len());
    assert!(own(&page).contains("Positions of 500 patches"));
    let Some(browser) = Browser::open() else { return };
    let file = CORNER.path("large.html");
    fs::write(&file, page).unwrap();
    is_drawn_whole(&browser, &file);
}
