//! Profiles, one at a time: data, fitted curve, pulses with error bars, and what the curve leaves. `profile.js` draws
//! them; here are their numbers.

use maud::{Markup, html};
use serde_json::{Map, Value, json};

use super::plot::{data, of_bounces, short};
use super::words::{count, sig};
use crate::history::behind::{CaptureKey, OnsetBehind};
use crate::report::Report;
use crate::report::arrivals::path_text;
use crate::report::waveforms::{Point, Waveform, Waveforms};
use crate::tables::Impulse;

/// Digits of drawn times, volts, and residuals.
const TIME_DIGITS: i32 = 7;
const VOLT_DIGITS: i32 = 4;
const RESIDUAL_DIGITS: i32 = 3;
/// A drawn curve whose chi-square is off that of the stage by more than this share is no faithful picture of it.
const FAITHFUL: f64 = 0.2;

/// What an address in the page calls a profile.
pub fn anchor((campaign, sensor, lit, seen): &CaptureKey) -> String {
    let plain = |name: &str| name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect::<String>();
    format!("profile-{}-{}-{lit}-{seen}", plain(campaign), plain(sensor))
}

/// What a profile is called.
fn name((campaign, sensor, lit, seen): &CaptureKey, is_with_campaign: bool) -> String {
    let campaign = if is_with_campaign { format!("{campaign}, ") } else { String::new() };
    format!("{campaign}{sensor}: lit {lit}, seen {seen}")
}

/// The section.
pub fn section(report: &Report) -> Markup {
    let waveforms = &report.waveforms;
    let Some(heading) = waveforms.heading.as_ref().filter(|_| !waveforms.chosen.is_empty()) else {
        return html! {};
    };
    let several = waveforms.chosen.iter().any(|waveform| waveform.capture.0 != waveforms.chosen[0].capture.0);
    let first = waveforms.telling().unwrap_or(&waveforms.chosen[0]);
    let named = |waveform: &Waveform| (anchor(&waveform.capture), record(waveform, &name(&waveform.capture, several)));
    let records: Map<String, Value> = waveforms.chosen.iter().map(named).collect();
    html! {
        section #profiles {
            h2 { "Profiles: does the model explain the waveforms?" }
            @if !waveforms.chi2_dofs.is_empty() { p { (goodness(waveforms)) } }
            div.viewer {
                button type="button" id="profile-before" aria-label="previous profile" { "<" }
                select id="profile-choice" aria-label="profile" {
                    @for waveform in &waveforms.chosen { option value=(anchor(&waveform.capture)) selected[std::ptr::eq(waveform, first)] { (option(waveform, several)) } }
                }
                button type="button" id="profile-after" aria-label="next profile" { ">" }
                button type="button" id="profile-scale" aria-pressed="false" { "linear scale" }
            }
            figure {
                div.plot id="profile" role="img" aria-label="the chosen profile with its fitted curve and residuals" aria-describedby="profile-note" data-viewer="profile-records" style="height:560px" {}
                (data("profile-records", &Value::Object(records).to_string()))
                figcaption { (caption(report, heading)) }
            }
            details #profile-pulses { summary { "The pulses of this profile as a table" } div.scroll tabindex="0" role="region" aria-label="pulses" {} }
        }
    }
}

fn option(waveform: &Waveform, several: bool) -> String {
    let chi2 = waveform.chi2_dof.map_or(String::new(), |chi2| format!(" (chi-square {})", sig(chi2, 3)));
    name(&waveform.capture, several) + &chi2
}

/// Chi-square of all profiles, not only of those in the page.
fn goodness(waveforms: &Waveforms) -> Markup {
    let (all, largest) = (&waveforms.chi2_dofs, waveforms.chi2_dofs.last().copied().unwrap_or(0.0));
    html! {
        "Chi-square per degree of freedom, over " (count(all.len(), "profile", "profiles")) ": median "
        strong { (sig(all[all.len() / 2], 3)) } ", largest " strong { (sig(largest, 3)) } ". Noise alone makes it 1."
    }
}

fn caption(report: &Report, heading: &str) -> Markup {
    let waveforms = &report.waveforms;
    let has_curve = waveforms.chosen.iter().any(|waveform| waveform.drawn_chi2_dof.is_some());
    html! {
        span #profile-note aria-live="polite" {} " "
        "Blue: mean of all valid shots, with a band of two standard errors. "
        @if has_curve {
            "Orange: the fitted curve, baseline plus pulses, each the sensor's response. Markers: the height and time of each pulse, with error bars of one standard deviation; colours count bounces. "
            "Below: data minus curve, in standard errors; a right model stays within the grey band (two standard errors) at 19 of 20 samples. "
        } @else {
            "This folder keeps no fitted pulses or no calibration, so that there is no curve to draw. "
        }
        "The vertical axis is linear near zero, where noise is, and logarithmic above it. "
        @if waveforms.chosen.len() < waveforms.all {
            (waveforms.chosen.len()) " of " (waveforms.all) " profiles are in this page: those with the most doubtful onsets, and others evenly spread. The rest: "
            code { "SELECT * FROM '" (report.folder) "/" (heading) "/*.parquet' WHERE lit = 1 AND seen = 2" } ". "
        }
        "Table " code { (heading) } "."
    }
}

/// The numbers of a profile, in short arrays.
fn record(waveform: &Waveform, name: &str) -> Value {
    let points = &waveform.points;
    let column = |value: &dyn Fn(&Point) -> Option<f64>, digits: i32| -> Vec<Option<f64>> {
        points.iter().map(|point| value(point).map(|value| short(value, digits))).collect()
    };
    let has_curve = waveform.drawn_chi2_dof.is_some();
    let mut record = json!({
        "name": name,
        "note": note(waveform),
        "unit": if waveform.is_counted { "photons" } else { "V" },
        "time": column(&|point| Some(point.time_ps), TIME_DIGITS),
        "mean": column(&|point| Some(point.mean_v), VOLT_DIGITS),
        "error": column(&|point| point.se_v.is_finite().then_some(point.se_v), 2),
        "pulses": waveform.impulses.iter().map(|impulse| pulse(impulse, onset_at(waveform, impulse.time_ps))).collect::<Vec<_>>(),
    });
    if has_curve {
        record["fit"] = json!(column(&|point| point.fitted_v, VOLT_DIGITS));
        record["residual"] = json!(column(&Point::residual, RESIDUAL_DIGITS));
    }
    record
}

fn pulse(impulse: &Impulse, onset: Option<&OnsetBehind>) -> Value {
    let bounces = onset.and_then(|onset| onset.path.as_ref()).map_or(0, Vec::len);
    let path = onset.map_or_else(|| "below the threshold".to_owned(), |onset| path_text(onset.path.as_deref()));
    json!({
        "time": short(impulse.time_ps, TIME_DIGITS),
        "time_sd": short(impulse.time_sd_ps, 2),
        "height": short(impulse.amplitude_v, VOLT_DIGITS),
        "height_sd": short(impulse.amplitude_sd_v, 2),
        "width": short(impulse.width_ps, 3),
        "path": path,
        "bounces": bounces.min(4),
        "colour": of_bounces(bounces),
    })
}

/// What is said of a profile as a whole.
fn note(waveform: &Waveform) -> String {
    let when = waveform.acquired_at.as_ref().map_or(String::new(), |when| format!(", captured at {when}"));
    let pulses = count(waveform.impulses.len(), "pulse", "pulses");
    let chi2 = match waveform.chi2_dof {
        None => String::new(),
        Some(chi2) => format!(", chi-square per degree of freedom {}", sig(chi2, 3)),
    };
    let drawn =
        waveform.drawn_chi2_dof.zip(waveform.chi2_dof).filter(|(drawn, chi2)| (drawn / chi2 - 1.0).abs() > FAITHFUL);
    let drawn = drawn.map_or(String::new(), |(drawn, _)| {
        format!(" The curve drawn here has {}: the table does not keep all of its shape.", sig(drawn, 3))
    });
    let together = waveform.drawn_chi2_dof.filter(|_| waveform.is_reciprocal).map_or(String::new(), |chi2| {
        let (_, _, lit, seen) = waveform.capture;
        format!(
            " Fitted together with lit {seen}, seen {lit}, in whose row the times stand; the heights were fitted for this page, with chi-square per degree of freedom {}.",
            sig(chi2, 3)
        )
    });
    let shots = count(waveform.shots as usize, "valid shot", "valid shots");
    format!("{pulses}{chi2}, {shots}, {} rejected{when}.{drawn}{together}", waveform.rejected)
}

/// The onset that an impulse became.
fn onset_at(waveform: &Waveform, time_ps: f64) -> Option<&OnsetBehind> {
    waveform.onsets.iter().find(|onset| onset.time_ps == Some(time_ps))
}
