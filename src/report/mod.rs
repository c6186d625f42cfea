//! What a result folder says, for the eye: one page of HTML ([`page`]) and figures for a paper ([`figures`]). Both draw
//! what [`Report::of`] reads from the tables. Only the fitted curves are no rows of a table: stored pulses and
//! responses draw them (`curve`).
//!
//! | file | section |
//! |---|---|
//! | `sources` | which tables are shown? |
//! | `campaigns` | the campaign folders behind them |
//! | `verdict` | is the answer to be believed? |
//! | `scene` | positions, error ellipsoids, paths of light, what is left open |
//! | `image` | a volume image of what a wall shows, as projections |
//! | `arrivals` | the onsets behind each patch |
//! | `stir` | images of the space-time impulse response |
//! | `waveforms` | chosen profiles with their error bands, impulses and labels |
//! | `curve` | the curve that impulses draw through a profile, and what it leaves |
//! | `responses` | the sensors |
//! | `residuals` | what the solution leaves over |
//! | `distances` | the matrix of distances, with its gaps |
//! | `growth` | what earlier runs knew |
//! | `provenance` | what was rejected; runs, their times, tables and their lineage |

mod arrivals;
mod campaigns;
mod curve;
mod distances;
pub mod figures;
mod growth;
mod image;
pub mod page;
mod provenance;
mod residuals;
mod responses;
mod scene;
mod sources;
mod stir;
mod verdict;
mod waveforms;

use std::path::Path;

use crate::history::HistoryError;
use crate::history::ancestry::Ancestry;
use crate::store::Shelf;

use arrivals::Arrivals;
use campaigns::Campaigns;
use distances::Distances;
use growth::Growth;
use image::Image;
use provenance::Provenance;
use residuals::Residuals;
use responses::Response;
use scene::Scene;
use sources::Sources;
use stir::Stir;
use verdict::Verdict;
use waveforms::Waveforms;

/// All that is drawn. Sizes are bounded, whatever the campaign's. Each section says which part it shows, and how to see
/// the rest.
pub struct Report {
    folder: String,
    provenance: Provenance,
    verdict: Verdict,
    scene: Option<Scene>,
    image: Option<Image>,
    arrivals: Arrivals,
    stir: Option<Stir>,
    waveforms: Waveforms,
    responses: Vec<Response>,
    residuals: Option<Residuals>,
    distances: Option<Distances>,
    growth: Growth,
}

impl Report {
    /// Reads a result folder.
    ///
    /// # Errors
    /// When it is none, or a table cannot be read.
    pub fn of(out: &Path) -> Result<Self, HistoryError> {
        let shelf = Shelf::look(out)?;
        let ancestry = Ancestry::of(&shelf)?;
        let sources = Sources::of(&ancestry);
        let provenance = Provenance::of(&shelf, &ancestry)?;
        let campaigns = Campaigns::of(&provenance);
        let arrivals = Arrivals::of(&sources)?;
        let scene = Scene::of(&sources, &campaigns, &arrivals)?;
        Ok(Self {
            folder: out.display().to_string(),
            verdict: Verdict::of(&provenance, scene.as_ref(), &arrivals),
            growth: Growth::of(&shelf, scene.as_ref().map(|scene| scene.heading.as_str()))?,
            scene,
            image: Image::of(&sources)?,
            stir: Stir::of(&sources, &arrivals)?,
            waveforms: Waveforms::of(&sources, &campaigns, &arrivals)?,
            responses: Response::all(&sources)?,
            residuals: Residuals::of(&sources, &arrivals)?,
            distances: Distances::of(&sources)?,
            arrivals,
            provenance,
        })
    }

    /// Whether the answer is to be believed, in a word, with reasons.
    #[must_use]
    pub fn verdict(&self) -> (&'static str, &[String]) {
        (self.verdict.word.text(), &self.verdict.reasons)
    }
}

/// At most `most` of `all`, evenly spread over them; their order is kept.
fn spread<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    if all.len() <= most {
        return all.to_vec();
    }
    (0..most).map(|i| all[i * all.len() / most].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chosen_ones_are_spread_evenly() {
        assert_eq!(spread(&[1, 2, 3], 5), [1, 2, 3]);
        assert_eq!(spread(&(0..10).collect::<Vec<_>>(), 5), [0, 2, 4, 6, 8]);
        assert!(spread::<i32>(&[], 3).is_empty());
    }
}
