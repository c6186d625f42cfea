//! What the stages know before they solve: what campaign.toml, calibration, sessions and earlier solutions say, in the
//! form in which estimators take it.

pub mod acquisition_time;
pub mod calibration;
pub mod campaign_fields;
pub mod corrections;
pub mod covariances;
pub mod delays;
pub mod flight_profile;
pub mod footprints;
pub mod relay_histograms;
pub mod scenes;
pub mod sensor_range;
pub mod sightings;
