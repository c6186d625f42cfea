//! Study: the paper's two experiments (its figure 8) from scope files, against what the paper prints. Prints the tables of docs/reproduction.md, and draws its figures.
//!
//! `cargo bench --bench reproduction -- mirror 40` for so many campaigns of one experiment; without a name all of them.

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/mirror.rs"]
mod mirror;
#[path = "reproduction/mod.rs"]
mod reproduction;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let campaigns = asked.iter().find_map(|argument| argument.parse().ok()).unwrap_or(40);
    let experiments: [(&str, fn(u64)); 1] = [("mirror", reproduction::mirror::print)];
    let is_asked =
        |name: &str| asked.iter().all(|asked| asked.parse::<u64>().is_ok()) || asked.iter().any(|asked| asked == name);
    experiments.iter().filter(|(name, _)| is_asked(name)).for_each(|(_, print)| print(campaigns));
}
