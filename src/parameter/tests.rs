use serde_json::{Value, json};

use super::*;

/// A number below its highest.
fn seen<T: for<'a> Deserialize<'a> + Serialize>(value: f64) -> Result<Value, String> {
    let number: T =
        toml::Value::Float(value).try_into().map_err(|error: toml::de::Error| error.message().to_owned())?;
    Ok(serde_json::to_value(number).unwrap())
}

#[test]
fn ends_are_within_or_not_as_the_type_says_and_nothing_else_than_finite_numbers_is() {
    let (tiny, huge) = (f64::from_bits(1), f64::MAX);
    for (within, without, read) in [
        (vec![tiny, huge], vec![0.0, -0.0, -tiny], seen::<Positive> as fn(f64) -> Result<Value, String>),
        (vec![0.0, tiny, huge], vec![-tiny, -huge], seen::<NonNegative>),
        (vec![tiny, 1.0_f64.next_down()], vec![0.0, 1.0, 1.0_f64.next_up()], seen::<Share>),
        (vec![-3.0, 4.0], vec![(-3.0_f64).next_down(), 4.0_f64.next_up()], seen::<Within<-3, 4>>),
    ] {
        for value in within {
            assert_eq!(read(value), Ok(json!(value)), "{value}");
        }
        for value in [without, vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY]].concat() {
            assert!(read(value).unwrap_err().contains(", expected "), "{value}");
        }
    }
}

#[test]
fn equal_numbers_look_equal() {
    assert_eq!(seen::<NonNegative>(-0.0).unwrap().to_string(), "0.0");
    let whole: Positive = toml::Value::Integer(2).try_into().unwrap();
    assert_eq!(serde_json::to_string(&whole).unwrap(), "2.0");
    assert_eq!(whole, Positive::new(2.0));
}

#[test]
fn counts_are_whole_and_bounded() {
    let count = |value: toml::Value| value.try_into::<Count<2, 5>>().ok().map(Count::get);
    assert_eq!([2, 5].map(|value| count(toml::Value::Integer(value))), [Some(2), Some(5)]);
    assert_eq!([1, 6, -2, i64::MAX].map(|value| count(toml::Value::Integer(value))), [None; 4]);
    assert_eq!(count(toml::Value::Float(3.0)), None);
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Sieve {
    method: Method,
    mesh_m: Positive,
    share: Option<Share>,
    holes: Count<1, 9>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Coarse,
    VeryFine,
}

impl Default for Sieve {
    fn default() -> Self {
        const MESH_M: Positive = Positive::new(2.0);
        Self { method: Method::Coarse, mesh_m: MESH_M, share: None, holes: Count::new(3) }
    }
}

fn sieve(params: &str) -> Result<Sieve, String> {
    let conflict = |sieve: &Sieve| (sieve.holes.get() == 7).then(|| Conflict("holes", "must not be 7".to_owned()));
    read(params.parse().unwrap(), &[Condition("share", "method", &["very-fine"])], conflict)
}

#[test]
fn every_fault_names_key_value_range_and_default() {
    for (params, fault) in [
        ("mesh_m = -3", "params.mesh_m = -3: must be above 0 and finite (default 2)"),
        ("holes = 4\nmesh_m = inf", "params.mesh_m = inf: must be above 0 and finite (default 2)"),
        ("mesh_m = 'wide'", "params.mesh_m = \"wide\": must be above 0 and finite (default 2)"),
        ("share = 1.0", "params.share = 1: must be above 0 and below 1 (default absent)"),
        ("holes = 0", "params.holes = 0: must be a whole number from 1 to 9 (default 3)"),
        ("holes = 2.5", "params.holes = 2.5: must be a whole number from 1 to 9 (default 3)"),
        ("mesh = 1.0", "params.mesh = 1: unknown key; did you mean `mesh_m`?"),
        (
            "method = 'very-fin'",
            "params.method = \"very-fin\": must be one of coarse, very-fine; did you mean `very-fine`? (default \"coarse\")",
        ),
        (
            "share = 0.5",
            "params.share = 0.5: has no effect while `method` is `coarse`, only while it is `very-fine`; take it out (default absent)",
        ),
        ("holes = 7", "params.holes = 7: must not be 7 (default 3)"),
    ] {
        assert_eq!(sieve(params).unwrap_err(), fault);
    }
    let fine = sieve("method = 'very-fine'\nshare = 0.5\nmesh_m = 1").unwrap();
    assert_eq!((fine.share, fine.mesh_m), (Some(Share::new(0.5)), Positive::new(1.0)));
}

#[test]
#[should_panic(expected = "outside of the interval")]
fn a_default_outside_of_its_interval_is_a_defect() {
    let _ = Share::new(1.0);
}
