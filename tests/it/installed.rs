//! What an installed program brings along: shell completions that shells accept, manual pages.

use std::path::Path;
use std::process::Command;

fn periscope(args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Commands of the program, from its help.
fn commands() -> Vec<String> {
    let help = periscope(&["--help"]);
    let listed = help.split_once("Commands:").unwrap().1.split_once("Options:").unwrap().0.to_owned();
    let names = listed.lines().filter_map(|line| line.strip_prefix("  ")).filter(|line| !line.starts_with(' '));
    names.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
}

#[test]
fn shells_that_are_here_accept_their_completions() {
    let folder = tempfile::tempdir().unwrap();
    // Asked of each shell: completes what follows `periscope de`.
    let questions = [
        (
            "bash",
            "source FILE; COMP_WORDS=(periscope de); COMP_CWORD=1; _periscope periscope de periscope; echo \"${COMPREPLY[@]}\"",
            "demo design",
        ),
        ("zsh", "autoload -U compinit; compinit -u -D; source FILE; echo ${_comps[periscope]}", "_periscope"),
        ("fish", "source FILE; complete -C 'periscope de' | string match -r '^\\w+'", "demo"),
    ];
    for (shell, question, answer) in questions {
        let file = folder.path().join(shell);
        let text = periscope(&["completions", shell]);
        assert!(text.contains("max-rejects"), "{text}");
        std::fs::write(&file, text).unwrap();
        match Command::new(shell).args(["-c", &question.replace("FILE", file.to_str().unwrap())]).output() {
            Ok(output) => {
                let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
                assert!(output.status.success() && err.is_empty() && out.contains(answer), "{shell}: {out}{err}");
            }
            Err(_) => eprintln!("{shell} is not here: its completions were not tried"),
        }
    }
}

#[test]
fn each_command_has_a_manual_page_that_man_can_show() {
    let folder = tempfile::tempdir().unwrap();
    periscope(&["man", folder.path().to_str().unwrap()]);
    let shown = |page: &Path| {
        let shown = Command::new("man").args(["--warnings", "-l"]).arg(page).env("MANPAGER", "cat").output();
        shown.map(|shown| {
            assert!(shown.stderr.is_empty(), "{}: {}", page.display(), String::from_utf8_lossy(&shown.stderr));
            String::from_utf8_lossy(&shown.stdout).into_owned()
        })
    };
    let commands = commands();
    assert!(commands.len() >= 16, "{commands:?}");
    for command in commands.iter().filter(|command| *command != "help") {
        let page = folder.path().join(format!("periscope-{command}.1"));
        assert!(page.exists(), "{command} has no page");
        if let Ok(shown) = shown(&page) {
            assert!(shown.contains(&format!("periscope-{command}")) && shown.contains("SYNOPSIS"), "{shown}");
        }
    }
    let whole = std::fs::read_to_string(folder.path().join("periscope.1")).unwrap();
    assert!(whole.contains("Exit codes"), "{whole}");
}
