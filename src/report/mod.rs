//! What a result folder says, for the eye: one page of HTML ([`page`]) and figures for a paper ([`figures`]). Both draw
//! what [`Report::of`] reads from the tables; nothing is computed again.
//!
//! | file | section |
//! |---|---|
//! | `sources` | which tables are shown? |
//! | `scene` | positions, error ellipsoids, paths of light, what is left open |
//! | `image` | a volume image of what a wall shows, as projections |
//! | `arrivals` | the onsets behind each patch |
//! | `stir` | images of the space-time impulse response |
//! | `waveforms` | chosen profiles with their error bands, impulses and labels |
//! | `responses` | the sensors |
//! | `residuals` | what the solution leaves over |
//! | `distances` | the matrix of distances, with its gaps |
//! | `provenance` | what was rejected; runs, their times, tables and their lineage |

mod arrivals;
mod distances;
pub mod figures;
mod image;
pub mod page;
mod provenance;
mod residuals;
mod responses;
mod scene;
mod sources;
mod stir;
mod waveforms;

use std::path::Path;

use crate::history::HistoryError;
use crate::history::ancestry::Ancestry;
use crate::store::Shelf;

use arrivals::Arrivals;
use distances::Distances;
use image::Image;
use provenance::Provenance;
use residuals::Residuals;
use responses::Response;
use scene::Scene;
use sources::Sources;
use stir::Stir;
use waveforms::Waveforms;

/// All that is drawn. Sizes are bounded, whatever the campaign's. Each section says which part it shows, and how to see
/// the rest.
pub struct Report {
    folder: String,
    provenance: Provenance,
    scene: Option<Scene>,
    image: Option<Image>,
    arrivals: Arrivals,
    stir: Option<Stir>,
    waveforms: Waveforms,
    responses: Vec<Response>,
    residuals: Option<Residuals>,
    distances: Option<Distances>,
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
        let arrivals = Arrivals::of(&sources)?;
        Ok(Self {
            folder: out.display().to_string(),
            scene: Scene::of(&sources, &provenance, &arrivals)?,
            image: Image::of(&sources)?,
            stir: Stir::of(&sources, &arrivals)?,
            waveforms: Waveforms::of(&sources, &arrivals)?,
            responses: Response::all(&sources)?,
            residuals: Residuals::of(&sources, &arrivals)?,
            distances: Distances::of(&sources)?,
            arrivals,
            provenance,
        })
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
