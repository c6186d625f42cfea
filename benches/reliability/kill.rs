//! Killed at any moment: the program ends by SIGKILL somewhere in a run, and the same command goes on. The result is
//! compared with that of an undisturbed run.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::many_parts::{ManyParts, errors};
use crate::score::Rate;

/// What became of the runs killed in one pass.
#[derive(Default)]
struct Row {
    kills: usize,
    /// Files of finished parts at the moment of the kill.
    finished: usize,
    same: usize,
    again: usize,
    left_over: usize,
}

/// `kill N`: N runs are killed once, and a tenth as many again and again until they finish. Each kill is reported on
/// standard error.
pub fn study(numbers: &[usize]) {
    let kills = numbers.first().copied().unwrap_or(200);
    let lab = ManyParts::new();
    let mut seconds: Vec<f64> = (0..5).map(|_| reference(&lab)).collect();
    seconds.sort_by(f64::total_cmp);
    let whole = lab.files("reference");
    let seconds = seconds[2];
    println!("\nAn undisturbed run takes {seconds:.2} s and writes {} Parquet files.", lab.finished("reference").len());
    once(&lab, kills, seconds, &whole);
    again_and_again(&lab, kills.div_ceil(10), seconds, &whole);
}

/// Seconds that an undisturbed run takes.
fn reference(lab: &ManyParts) -> f64 {
    let _ = fs::remove_dir_all(lab.path("reference"));
    let start = Instant::now();
    let run = lab.run("reference");
    assert_eq!(run.status.code(), Some(0), "{}", errors(&run));
    start.elapsed().as_secs_f64()
}

fn once(lab: &ManyParts, kills: usize, seconds: f64, whole: &BTreeMap<PathBuf, blake3::Hash>) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut rows: BTreeMap<String, Row> = BTreeMap::new();
    let (mut killed, mut ended_before) = (0, 0);
    while killed < kills {
        let _ = fs::remove_dir_all(lab.path("killed"));
        let Some(kill) = lab.kill("killed", Duration::from_secs_f64(rng.random_range(0.0..seconds))) else {
            ended_before += 1;
            continue;
        };
        killed += 1;
        let run = lab.run("killed");
        assert_eq!(run.status.code(), Some(0), "{}", errors(&run));
        let is_same = lab.files("killed") == *whole;
        let (again, left_over) = (lab.written_again(&kill.finished, "killed"), lab.left_over("killed").len());
        eprintln!(
            "{killed}: {}; {} files finished, {again} again, {left_over} left, same {is_same}",
            kill.under_way,
            kill.finished.len()
        );
        let row = rows.entry(kill.under_way).or_default();
        row.kills += 1;
        row.finished += kill.finished.len();
        row.same += usize::from(is_same);
        row.again += again;
        row.left_over += left_over;
    }
    println!(
        "\n| being made | kills | files of finished parts at the kill, mean | resumed to the same bytes | finished files written again | half-written files left |"
    );
    println!("|---|---|---|---|---|---|");
    let print = |name: &str, row: &Row| {
        let mean = row.finished as f64 / row.kills.max(1) as f64;
        println!("| {name} | {} | {mean:.1} | {} | {} | {} |", row.kills, row.same, row.again, row.left_over);
    };
    let mut all = Row::default();
    for (name, row) in &rows {
        print(name, row);
        all.kills += row.kills;
        all.finished += row.finished;
        all.same += row.same;
        all.again += row.again;
        all.left_over += row.left_over;
    }
    print("all", &all);
    println!(
        "\nThe same bytes: {} of {}, share {}. Written again: {} of {} files. {ended_before} runs had ended before their kill and are not counted.",
        all.same,
        all.kills,
        Rate { hits: all.same, of: all.kills },
        all.again,
        all.finished
    );
}

/// Runs that are killed again and again until one gets through.
fn again_and_again(lab: &ManyParts, runs: usize, seconds: f64, whole: &BTreeMap<PathBuf, blake3::Hash>) {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut kills, mut most, mut same, mut again) = (0, 0, 0, 0);
    for _ in 0..runs {
        let _ = fs::remove_dir_all(lab.path("killed"));
        let mut own = 0;
        let mut finished = BTreeMap::new();
        while let Some(kill) = lab.kill("killed", Duration::from_secs_f64(rng.random_range(0.0..0.5 * seconds))) {
            again += finished.iter().filter(|(path, was)| kill.finished.get(*path) != Some(*was)).count();
            finished = kill.finished;
            own += 1;
        }
        again += lab.written_again(&finished, "killed");
        let last = lab.run("killed");
        assert_eq!(last.status.code(), Some(0), "{}", errors(&last));
        same += usize::from(lab.files("killed") == *whole && lab.left_over("killed").is_empty());
        eprintln!("{own} kills in one run, {again} files again so far, same {same}");
        kills += own;
        most = most.max(own);
    }
    println!(
        "\nKilled again and again: {runs} runs with {kills} kills, {most} at most in one; the same bytes and nothing left over: {}; finished files written again: {again}.",
        Rate { hits: same, of: runs }
    );
}
