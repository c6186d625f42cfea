//! What a browser draws of a page, on a screen and on a phone, and what a reader does there.

use std::fs;
use std::path::Path;

use super::{CORNER, page_of};
use crate::browser::Browser;

/// Something stands on the screen within this time.
const FIRST_PAINT_MS: f64 = 1000.0;
/// Width of a phone.
const PHONE_PIXELS: u32 = 390;

/// Opens a page, brings each plot into view, and waits until it is drawn; the same on a phone.
pub(super) fn is_drawn_whole(browser: &Browser, file: &Path) {
    browser.narrow_to(PHONE_PIXELS);
    is_drawn_at_this_width(browser, file);
    browser.widen();
    is_drawn_at_this_width(browser, file);
}

fn is_drawn_at_this_width(browser: &Browser, file: &Path) {
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
    // Curve and residuals stand beside the data, on a scale that shows noise and peaks.
    let named =
        |name: &str| format!("document.getElementById('profile').data.find((trace) => trace.name === '{name}')");
    for trace in ["data", "fitted curve", "residual"] {
        browser.wait(trace, &format!("{}?.y.length > 20", named(trace)));
    }
    let top = format!("Math.max(...{}.y)", named("data"));
    let on_asinh = browser.run(&format!("return {top};")).as_f64().unwrap();
    let ticks = browser.run("return document.getElementById('profile').layout.yaxis.ticktext.join();");
    assert!(ticks.as_str().unwrap().contains("mV"), "{ticks}");
    browser.run("document.getElementById('profile-scale').click();");
    browser.wait("volts as they are", &format!("{top} !== {on_asinh}"));
    let volts = browser.run(&format!("return {top};")).as_f64().unwrap();
    let noise = browser.run(&format!("return {volts} / Math.sinh({on_asinh});")).as_f64().unwrap();
    assert!(volts > 0.0 && noise > 0.0 && noise < volts / 3.0, "{volts} V at {on_asinh}");
    assert_eq!(browser.errors(), Vec::<String>::new());
}

/// Whoever cannot see the plots, or has no mouse.
#[test]
fn plots_have_words_and_need_no_mouse() {
    let Some(browser) = Browser::open() else { return };
    let file = CORNER.path("words.html");
    fs::write(&file, page_of(&CORNER.path("out"))).unwrap();
    is_drawn_whole(&browser, &file);
    let wordless = "return [...document.querySelectorAll('.plot')].filter((plot) => !(plot.getAttribute('aria-label')?.length > 25)).map((plot) => plot.id);";
    assert_eq!(browser.run(wordless), serde_json::json!([]));
    let pulses = browser.run("return document.querySelectorAll('#profile-pulses tbody tr').length;");
    assert!(pulses.as_u64() > Some(0), "the pulses as a table");
    let eye = "JSON.stringify(document.getElementById('scene')._fullLayout.scene.camera.eye)";
    let before = browser.run(&format!("return {eye};"));
    browser.run("document.querySelector('[data-turn=left]').click();");
    browser.wait("another view", &format!("{eye} !== {}", serde_json::json!(before.as_str().unwrap())));
    // Numbers in space: each is placed where it covers no other, or left out.
    let apart = "const plot = document.getElementById('scene'), texts = new Map();
        plot.data.forEach((trace, n) => { if (/text/.test(trace.mode ?? '')) texts.set(n, [...trace.text]); });
        const at = projected(plot), boxes = [];
        for (const [n, all] of texts) all.forEach((text, k) => {
            const { x, y, z, textposition } = plot.data[n];
            if (text) boxes.push(labelBox(at(x[k], y[k], z[k]), text, Array.isArray(textposition) ? textposition[k] : textposition));
        });
        return boxes.length > 6 && boxes.every((a, i) => boxes.every((b, k) => i === k || !overlap(a, b)));";
    browser.wait("numbers that do not collide", &format!("(() => {{ {apart} }})()"));
    assert_eq!(browser.errors(), Vec::<String>::new());
}
