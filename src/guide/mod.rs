//! The guide: the pages of `docs/guide/`, here so that they stand beside the reference. Start at [`guide`](start).
//!
//! A page is Markdown that reads the same in both places. What it links to is defined twice: at its own end, as the
//! files lie, and in `links.md`, as the modules do; the definition that comes first counts, and here that is the
//! second.

macro_rules! pages {
    ($($name:ident = $file:literal;)*) => {$(
        #[doc = include_str!("links.md")]
        #[doc = include_str!(concat!("../../docs/guide/", $file))]
        pub mod $name {}
    )*};
}

pages! {
    start = "README.md";
    quick_start = "quick-start.md";
    your_campaign = "your-campaign.md";
    before_you_capture = "before-you-capture.md";
    files = "files.md";
    running = "running.md";
    report = "report.md";
    python = "python.md";
    theory = "theory.md";
    glossary = "glossary.md";
}

/// A page for each stage of a pipeline.
pub mod stages {
    pages! {
        anchor = "stages/anchor.md";
        average = "stages/average.md";
        calibrate = "stages/calibrate.md";
        characterize = "stages/characterize.md";
        decompose = "stages/decompose.md";
        deconvolve = "stages/deconvolve.md";
        detect = "stages/detect.md";
        embed = "stages/embed.md";
        first_returns = "stages/first_returns.md";
        shape = "stages/shape.md";
        mesh = "stages/mesh.md";
        image = "stages/image.md";
        import = "stages/import.md";
        ingest = "stages/ingest.md";
        ingest_pulses = "stages/ingest_pulses.md";
        label = "stages/label.md";
        locate = "stages/locate.md";
        measure = "stages/measure.md";
        predict = "stages/predict.md";
        range = "stages/range.md";
        recalibrate = "stages/recalibrate.md";
        refine = "stages/refine.md";
        reflect = "stages/reflect.md";
        search = "stages/search.md";
        surface = "stages/surface.md";
        conclude = "stages/conclude.md";
        track = "stages/track.md";
        triangulate = "stages/triangulate.md";
    }
}
