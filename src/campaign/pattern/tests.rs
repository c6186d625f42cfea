use super::*;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

fn read(pattern: &str, path: &str) -> String {
    match Pattern::parse(pattern).unwrap().read(path) {
        Reading::No => "no".to_owned(),
        Reading::Yes(bound) => bound.to_string(),
        Reading::Ambiguous(a, b) => format!("{a} | {b}"),
    }
}

#[test]
fn numbers_and_names_are_taken_whole() {
    let scene = "raw/scene/L{lit}_P{seen}.trc";
    assert_eq!(read(scene, "raw/scene/L007_P12.trc"), "lit = 7, seen = 12");
    assert_eq!(read(scene, "raw/scene/L000_P0.trc"), "lit = 0, seen = 0");
    assert_eq!(read(scene, "raw/scene/L7_P12.trc.bak"), "no");
    assert_eq!(read(scene, "raw/scene/L7_P.trc"), "no");
    assert_eq!(read("*{shot}*", "run12b"), "shot = 12");
    assert_eq!(read("{range}.csv", "high-2_b.csv"), "range = high-2_b");
    assert_eq!(read("{range}_L{lit}*.csv", "low-2_L3_x.csv"), "lit = 3, range = low-2");
    assert_eq!(read("{range}_L{lit}.csv", "low_2_L3.csv"), "no");
}

#[test]
fn a_star_takes_the_place_of_a_value_wherever_it_stands() {
    let starred = |pattern: &str, path: &str| Pattern::parse(pattern).unwrap().starred(path, Axis::Shot);
    assert_eq!(starred("r/7_{shot}.trc", "r/7_007.trc"), "r/7_*.trc");
    assert_eq!(starred("r/{shot}/*_{shot}.trc", "r/03/3_3.trc"), "r/*/3_*.trc");
    assert_eq!(starred("r/*.trc", "r/03.trc"), "r/03.trc");
}

#[test]
fn stars_stay_in_their_folder_and_double_stars_do_not() {
    assert_eq!(read("raw/*.npy", "raw/a.npy"), "");
    assert_eq!(read("raw/*.npy", "raw/day1/a.npy"), "no");
    assert_eq!(read("raw/**/*.npy", "raw/a.npy"), "");
    assert_eq!(read("raw/**/*.npy", "raw/day1/am/a.npy"), "");
    assert_eq!(read("**/L{lit}.npy", "day1/L3.npy"), "lit = 3");
    assert_eq!(read("*ä*/L{lit}.npy", "prä/L3.npy"), "lit = 3");
}

/// States that a reading enters, which bound its time.
fn states(pattern: &str, path: &str) -> usize {
    Reader::of(&Pattern::parse(pattern).unwrap().tokens, path).entered.len()
}

#[test]
fn no_pattern_takes_long() {
    let long = "a".repeat(200);
    let distinct = (0..60).map(|n| format!("a{n}")).collect::<Vec<_>>().join(".");
    let two = "sensor = a, range = a, channel = b | sensor = a, range = b, channel = b";
    for (pattern, path, result) in [
        ("*a".repeat(30), format!("{long}b"), "no"),
        ("*a".repeat(30) + "*{lit}", format!("{long}7"), "lit = 7"),
        ("**/".repeat(60) + "x", "a/".repeat(200) + "y", "no"),
        ("*{sensor}*{channel}*{range}*.x".to_owned(), "a.".repeat(100), "no"),
        ("*{sensor}*{channel}*{range}*".to_owned(), "a.".repeat(100), "sensor = a, range = a, channel = a"),
        ("*{sensor}*{channel}*{range}*".to_owned(), "a.b.".repeat(50), two),
        ("*{sensor}*{sensor}*{range}*{range}*".to_owned(), distinct, "no"),
    ] {
        let states = states(&pattern, &path);
        assert_eq!(read(&pattern, &path), result, "{pattern}");
        // Each token at each place, behind a star or not.
        let most = 2 * TOKENS * (path.len() + 1);
        assert!(states <= most, "{pattern}: {states} states, more than {most}");
    }
    let text = Pattern::parse(&"a*".repeat(40)).unwrap_err().to_string();
    assert!(text.contains("64 are enough"), "{text}");
}

#[test]
fn a_repeated_placeholder_must_agree_and_two_readings_are_reported() {
    assert_eq!(read("L{lit}/L{lit}_{shot}.trc", "L04/L4_1.trc"), "lit = 4, shot = 1");
    assert_eq!(read("L{lit}/L{lit}_{shot}.trc", "L4/L5_1.trc"), "no");
    let two = read("{sensor}x{channel}", "axbxc");
    assert_eq!(two, "sensor = axb, channel = c | sensor = a, channel = bxc");
    assert_eq!(read("{sensor}ch{channel}", "s1ch2"), "sensor = s1, channel = 2");
}

#[test]
fn bad_patterns_are_refused_with_the_fix() {
    for (pattern, part) in [
        ("raw/L{lt}.trc", "did you mean `lit`?"),
        ("raw/L{lit}{seen}.trc", "put a sign between"),
        ("raw/**.trc", "`**/`"),
        ("raw/L{lit.trc", "close"),
        ("raw/Llit}.trc", "open"),
        ("/raw/a.trc", "relative"),
        ("raw/../a.trc", "relative"),
        ("raw\\a.trc", "`/`"),
        ("", "empty"),
    ] {
        let text = Pattern::parse(pattern).unwrap_err().to_string();
        assert!(text.contains(part), "{text}");
    }
}

/// A piece of a pattern, the equivalent regular expression, and a text that matches.
fn piece() -> impl Strategy<Value = (String, String, String)> {
    let text = prop::sample::select(vec!["_", "/", "L", "P_", ".trc", "a/b", "-"]);
    prop_oneof![
        text.prop_map(|t| (t.into(), regex_lite::escape(t), t.into())),
        "[a-c_.]{0,3}".prop_map(|t| ("*".into(), "[^/]*".into(), t)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn matches_are_those_of_a_regular_expression(
        pieces in prop::collection::vec(piece(), 0..5),
        (lit, seen) in (0_u32..200, 0_u32..200),
        noise in "[LP_/.ab0-9-]{0,12}",
    ) {
        let part = |of: fn(&(String, String, String)) -> &String| {
            pieces.iter().map(of).map(String::as_str).collect::<String>()
        };
        // A bar separates the numbers from all else, so that pattern and regular expression agree on what a number
        // is.
        let pattern = format!("x|{{lit}}|{}|{{seen}}", part(|p| &p.0));
        prop_assume!(!pattern.contains("**") && !pattern.contains("//"));
        let regex = format!(r"^x\|([0-9]+)\|{}\|([0-9]+)$", part(|p| &p.1));
        let regex = regex_lite::Regex::new(&regex).unwrap();
        let parsed = Pattern::parse(&pattern).unwrap();
        for middle in [part(|p| &p.2), noise] {
            let path = format!("x|{lit:03}|{middle}|{seen}");
            let reading = parsed.read(&path);
            prop_assert_eq!(reading != Reading::No, regex.is_match(&path), "{} {}", pattern, path);
            if let Reading::Yes(bound) = reading {
                let (lit, seen) = (lit.to_string(), seen.to_string());
                prop_assert_eq!(bound.get(Axis::Lit), Some(lit.as_str()));
                prop_assert_eq!(bound.get(Axis::Seen), Some(seen.as_str()));
            }
        }
    }
}
