//! Every command of README and guide, run as it is written, and what the page says it prints.
//!
//! - A block ```` ```sh ```` is run line by line in a folder of the page's own, with `pipelines/` of this repository in
//!   it and the program on the path.
//! - A line may end with 0, or with a code that its comment names (`# ... exit code 3`).
//! - A block ```` ```text ```` right after it is what it prints: each line must be in the output, blanks aside; `...`
//!   stands for what is left out.
//! - A block that cannot be run here has the reason above it, `<!-- not run: ... -->`. The test says which these are.

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

/// What pages assume to be there already: (page, commands that make it).
const ASSUMED: [(&str, &str); 3] = [
    ("README.md", "periscope simulate pipelines/scenes/tiny.toml --out my-campaign"),
    (
        "docs/guide/report.md",
        "periscope simulate pipelines/scenes/tiny.toml --out my-campaign
         periscope run all-visible --campaign my-campaign --out results",
    ),
    // A campaign of one's own, and results of another day with another threshold.
    (
        "docs/guide/running.md",
        "periscope simulate pipelines/scenes/tiny.toml --out my-campaign
         periscope run all-visible --campaign my-campaign --out other-results --set onsets.threshold_sigma=8 # or exit code 3",
    ),
];

/// A block of a page.
#[derive(Debug, PartialEq)]
enum Block {
    /// Commands.
    Sh(String),
    /// Commands that cannot be run here, and why.
    NotRun(String),
    /// What the commands before it print.
    Text(String),
}

/// Blocks of commands of a page, and those of text that follow them directly.
fn blocks(page: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut lines = page.lines();
    let (mut reason, mut follows) = (None, false);
    while let Some(line) = lines.next() {
        let Some(fence) = line.strip_prefix("```") else {
            if let Some(rest) = line.strip_prefix("<!-- not run: ") {
                reason = rest.strip_suffix(" -->").map(str::to_owned);
            } else if !line.is_empty() {
                (reason, follows) = (None, false);
            }
            continue;
        };
        let body: String =
            lines.by_ref().take_while(|line| !line.starts_with("```")).flat_map(|line| [line, "\n"]).collect();
        match fence {
            "sh" => blocks.push(reason.take().map_or(Block::Sh(body), Block::NotRun)),
            "text" if follows && matches!(blocks.last(), Some(Block::Sh(_))) => blocks.push(Block::Text(body)),
            _ => {}
        }
        follows = fence == "sh";
    }
    blocks
}

/// The README and all pages of the guide: name, text.
fn pages() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages = vec![PathBuf::from("README.md")];
    for folder in ["docs/guide", "docs/guide/stages"] {
        let files =
            fs::read_dir(root.join(folder)).unwrap().map(|entry| Path::new(folder).join(entry.unwrap().file_name()));
        pages.extend(files.filter(|file| file.extension().is_some_and(|extension| extension == "md")));
    }
    pages.sort();
    pages.iter().map(|page| (page.display().to_string(), fs::read_to_string(root.join(page)).unwrap())).collect()
}

/// A block's commands: a line each, with the lines that it goes on over (a `\\` at the end), and those that it is fed
/// (`<<'END'`).
fn commands(block: &str) -> Vec<String> {
    let mut commands: Vec<String> = Vec::new();
    let mut is_open = false;
    for line in block.lines() {
        match commands.last_mut().filter(|_| is_open) {
            Some(command) => write!(command, "\n{line}").unwrap(),
            None => commands.push(line.to_owned()),
        }
        let command = commands.last().expect("pushed above");
        is_open = line.ends_with('\\') || (command.contains("<<'END'") && line != "END");
    }
    commands
}

/// Runs commands in a folder: what they print, or which one failed and how.
fn run(folder: &Path, block: &str) -> Result<String, String> {
    let mut printed = String::new();
    for command in commands(block) {
        let path = format!("{}:{}", folder.join("bin").display(), std::env::var("PATH").unwrap());
        let output = Command::new("sh")
            .args(["-c", &command])
            .current_dir(folder)
            .env("PATH", path)
            .env("HOME", folder)
            .output()
            .unwrap();
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        write!(printed, "{}{}", text(&output.stdout), text(&output.stderr)).unwrap();
        let code = output.status.code().unwrap_or(-1);
        if code != 0 && !command.contains(&format!("exit code {code}")) {
            return Err(format!("`{command}` ends with exit code {code}: {printed}"));
        }
    }
    Ok(printed)
}

/// Lines of `shown` that are not in what was printed.
fn not_printed<'a>(shown: &'a str, printed: &str) -> Vec<&'a str> {
    let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let printed: Vec<String> = printed.lines().map(words).collect();
    let is_printed = |line: &&str| {
        let parts: Vec<String> = line.split("...").map(words).collect();
        printed.iter().any(|line| {
            parts.iter().try_fold(&line[..], |rest, part| Some(rest.split_once(part.as_str())?.1)).is_some()
        })
    };
    shown.lines().filter(|line| !is_printed(line)).collect()
}

/// What is wrong with a page, and the blocks of it that were not run.
fn check(name: &str, text: &str) -> (Vec<String>, Vec<String>) {
    let (mut wrong, mut not_run) = (Vec::new(), Vec::new());
    let folder = tempfile::tempdir().unwrap();
    symlink(Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines"), folder.path().join("pipelines")).unwrap();
    fs::create_dir(folder.path().join("bin")).unwrap();
    symlink(env!("CARGO_BIN_EXE_periscope"), folder.path().join("bin/periscope")).unwrap();
    // The program is built already: `cargo run` only runs it.
    let cargo = folder.path().join("bin/cargo");
    fs::write(&cargo, "#!/bin/sh\n[ \"$1 $2 $3\" = 'run --release --' ] && shift 3 && exec periscope \"$@\"\n")
        .unwrap();
    fs::set_permissions(&cargo, fs::Permissions::from_mode(0o755)).unwrap();
    for (_, commands) in ASSUMED.iter().filter(|(page, _)| *page == name) {
        run(folder.path(), commands).unwrap();
    }
    let mut printed = String::new();
    for block in blocks(text) {
        match block {
            Block::Sh(commands) => match run(folder.path(), &commands) {
                Ok(text) => printed = text,
                Err(error) => {
                    wrong.push(format!("{name}: {error}"));
                    break;
                }
            },
            Block::NotRun(reason) => not_run.push(format!("{name}: not run: {reason}")),
            Block::Text(shown) => {
                let missing = not_printed(&shown, &printed);
                if !missing.is_empty() {
                    wrong.push(format!("{name}: shown, but not printed: {missing:#?}; printed is:\n{printed}"));
                }
            }
        }
    }
    (wrong, not_run)
}

#[test]
fn every_command_of_readme_and_guide_works_as_it_is_written() {
    let pages = pages();
    assert!(pages.len() > 20, "{}", pages.len());
    let results: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = pages.iter().map(|(name, text)| scope.spawn(move || check(name, text))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    // Past the capture of output: a person who runs the tests should see what they do not cover.
    results.iter().flat_map(|(_, not_run)| not_run).for_each(|line| writeln!(std::io::stderr(), "{line}").unwrap());
    let wrong: Vec<&str> = results.iter().flat_map(|(wrong, _)| wrong).map(String::as_str).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn blocks_are_found_and_what_is_printed_is_compared() {
    let page = "a\n\n```sh\nx 1\ny\n```\n\n```text\nz ... 5\n```\n\n<!-- not run: no network -->\n```sh\nw\n```\n\nprose\n\n```text\nfree\n```\n";
    let expected = [Block::Sh("x 1\ny\n".into()), Block::Text("z ... 5\n".into()), Block::NotRun("no network".into())];
    assert_eq!(blocks(page), expected);
    assert!(not_printed("z ... 5\n...\n", "before\n  z  4 and  5 mm\n").is_empty());
    assert_eq!(not_printed("z 6\n", "z 5\n"), ["z 6"]);
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(commands("cat <<'END'\na\nEND\nb"), ["cat <<'END'\na\nEND", "b"]);
    assert_eq!(run(folder.path(), "echo a \\\n  b\nexit 3 # exit code 3 when it differs\n").unwrap(), "a b\n");
    assert!(run(folder.path(), "exit 3\n").is_err());
}
