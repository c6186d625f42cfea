//! The pipelines in the program: the files of `pipelines/`, by their names.

use crate::campaign::Campaign;
use crate::campaign::keys::{PatchRole, SensorKind};

/// A pipeline in the program.
#[derive(Debug, PartialEq, Eq)]
pub struct BuiltIn {
    /// Name: that of its file, without extension.
    pub name: &'static str,
    /// Text of its file.
    pub text: &'static str,
}

macro_rules! built_in {
    ($($name:literal),* $(,)?) => {
        /// All pipelines in the program: first the one that runs by default, then the others by their names.
        pub const BUILT_IN: &[BuiltIn] = &[$(BuiltIn {
            name: $name,
            text: include_str!(concat!("../../../pipelines/", $name, ".toml")),
        }),*];
    };
}

built_in!(
    "scene",
    "all-visible",
    "average",
    "barcode",
    "barcode-blocked",
    "characterize",
    "first-returns",
    "image",
    "lidar",
    "locate",
    "mirror",
    "tdr",
);

/// Name of the pipeline for any scene whose campaign declares no mirror, no strips and no relay wall.
pub const DEFAULT: &str = "scene";

/// Pipelines for what campaigns declare: name, what stands in campaign.toml, and whether it does.
const DECLARED: [(&str, &str, fn(&[Campaign]) -> bool); 4] = [
    ("mirror", "patches with role = \"mirror\"", |campaigns| {
        campaigns.iter().any(|campaign| campaign.patches.values().any(|patch| patch.role == PatchRole::Mirror))
    }),
    ("barcode", "hidden patches with `through`", |campaigns| {
        campaigns.iter().any(|campaign| campaign.patches.values().any(|patch| patch.through.is_some()))
    }),
    ("lidar", "files of a lidar: .pls or .las in every [[captures]] rule", |campaigns| {
        !campaigns.is_empty() && campaigns.iter().all(Campaign::is_of_lidar)
    }),
    ("locate", "a relay wall: sensors that count photons, and a `position_m` for each visible patch", |campaigns| {
        !campaigns.is_empty() && campaigns.iter().all(is_relay_wall)
    }),
];

/// Points of the wall at the least for which histograms are fitted together. With fewer, arrivals have few enough
/// assignments to be labelled one by one.
const WALL_POINTS: usize = 16;

/// Whether a campaign counts photons from points of a wall whose places are given.
fn is_relay_wall(campaign: &Campaign) -> bool {
    let counts = |kind: SensorKind| kind == SensorKind::Counts;
    let mut visible = campaign.patches.values().filter(|patch| patch.role == PatchRole::Visible);
    campaign.sensors.values().all(|sensor| counts(sensor.kind))
        && campaign.views.is_empty()
        && visible.clone().count() >= WALL_POINTS
        && visible.all(|patch| patch.position_m.is_some())
}

/// Names that pipelines had, and the pipeline that does their work now.
const RETIRED: [(&str, &str); 6] = [
    ("around-the-corner", "scene"),
    ("faint", "scene"),
    ("hidden-plane", "scene"),
    ("relay-wall", "scene"),
    ("separate", "scene"),
    ("visible", "scene"),
];

impl BuiltIn {
    /// The pipeline that runs unless the user names another, and what in the campaigns says so; `None` where nothing
    /// special is declared.
    ///
    /// # Panics
    /// Never: all these are in the program.
    #[must_use]
    pub fn for_campaigns(campaigns: &[Campaign]) -> (&'static Self, Option<&'static str>) {
        let declared = DECLARED.iter().find(|(.., is_declared)| is_declared(campaigns));
        let (name, reason) = declared.map_or((DEFAULT, None), |(name, reason, _)| (*name, Some(*reason)));
        (Self::named(name).expect("a pipeline of the program"), reason)
    }

    /// The pipeline of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        BUILT_IN.iter().find(|pipeline| pipeline.name == name)
    }

    /// The pipeline that does the work of a retired one; `None` for all other names.
    #[must_use]
    pub(super) fn successor(name: &str) -> Option<&'static str> {
        RETIRED.iter().find(|(retired, _)| *retired == name).map(|(_, successor)| *successor)
    }

    /// The scene that it is for: the first line of its text, a sentence.
    #[must_use]
    pub fn purpose(&self) -> &'static str {
        self.text.lines().next().unwrap_or_default().trim_start_matches(['#', ' '])
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::super::Spec;
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_in_the_program() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines");
        let files = std::fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.path());
        let files = files.filter(|file| file.extension().is_some_and(|extension| extension == "toml"));
        let files: BTreeSet<String> =
            files.map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
        let names: BTreeSet<String> = BUILT_IN.iter().map(|pipeline| pipeline.name.to_owned()).collect();
        assert_eq!(names, files, "src/pipeline/spec/built_in.rs lists the files of pipelines/");
        assert!(BUILT_IN[1..].is_sorted_by_key(|pipeline| pipeline.name));
        assert_eq!(BUILT_IN[0].name, DEFAULT);
        for (retired, successor) in RETIRED {
            assert!(BuiltIn::named(retired).is_none() && BuiltIn::named(successor).is_some(), "{retired}");
        }
    }

    #[test]
    fn what_a_campaign_declares_chooses() {
        let with_sensor = |sensor: &str, patches: &str| {
            let folder = tempfile::tempdir().unwrap();
            let text = format!(
                "[campaign]\nname = 'a'\n[sensors.s1]\n{sensor}{patches}[[captures]]\nrole = 'scene'\nfiles = '{{lit}}_{{seen}}.npy'\n"
            );
            std::fs::write(folder.path().join("campaign.toml"), text).unwrap();
            Campaign::load(folder.path()).unwrap()
        };
        let campaign = |patches: &str| with_sensor("", patches);
        let plain = campaign("[patches.1]\nposition_m = [1.0, 0.0, 0.0]\n");
        let mirror = campaign("[patches.1]\nrole = 'mirror'\nray = { from = 'laser', direction = [0.0, 1.0, 0.0] }\n");
        let strips = campaign("[patches.1]\n[patches.2]\nrole = 'hidden'\nthrough = 1\n");
        assert_eq!(BuiltIn::for_campaigns(&[]).0.name, DEFAULT);
        assert_eq!(BuiltIn::for_campaigns(std::slice::from_ref(&plain)), (BuiltIn::named(DEFAULT).unwrap(), None));
        let (pipeline, reason) = BuiltIn::for_campaigns(&[plain, mirror]);
        assert!(pipeline.name == "mirror" && reason.is_some());
        assert_eq!(BuiltIn::for_campaigns(&[strips]).0.name, "barcode");
        let flight = with_sensor("", "");
        let mut lidar = flight.clone();
        lidar.captures[0].files = Some("strip{lit}.LAS".to_owned());
        assert_eq!(BuiltIn::for_campaigns(&[lidar.clone()]).0.name, "lidar");
        assert_eq!(BuiltIn::for_campaigns(&[lidar, flight]).0.name, DEFAULT, "one of two campaigns is of no lidar");
        let wall = |points: usize, more: &str| {
            let point = |n: usize| format!("[patches.{n}]\nposition_m = [{n}.0, 0.0, 0.0]\n");
            (1..=points).map(point).collect::<String>() + more
        };
        let counter = "kind = 'counts'\n";
        for (sensor, patches, name) in [
            (counter, wall(16, ""), "locate"),
            (counter, wall(16, "[patches.99]\nrole = 'hidden'\n"), "locate"),
            (counter, wall(15, ""), DEFAULT),
            (counter, wall(16, "[patches.99]\n"), DEFAULT),
            ("", wall(16, ""), DEFAULT),
        ] {
            assert_eq!(BuiltIn::for_campaigns(&[with_sensor(sensor, &patches)]).0.name, name, "{sensor}{patches}");
        }
    }

    #[test]
    fn every_pipeline_begins_with_its_purpose_and_is_accepted() {
        for pipeline in BUILT_IN {
            let purpose = pipeline.purpose();
            assert!(pipeline.text.starts_with("# "), "{}: the first line is a comment", pipeline.name);
            assert!(purpose.len() <= 100, "{}: {purpose}", pipeline.name);
            assert!(purpose.ends_with('.') && !purpose.trim_end_matches('.').contains(". "), "{purpose}");
            let spec = Spec::load(Path::new(pipeline.name), &[]);
            assert!(spec.is_ok(), "{}: {}", pipeline.name, spec.err().unwrap());
        }
    }
}
