//! The readers' sources, and nothing else of periscope.

#[path = "../../../src/campaign"]
pub mod campaign {
    pub mod companions;
}
#[path = "../../../src/formats/mod.rs"]
pub mod formats;
#[path = "../../../src/waveform.rs"]
pub mod waveform;
