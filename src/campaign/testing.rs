//! The paper's campaign for the tests of this room.

use super::tables::Study;
use super::{CampaignSpec, Configuration};

/// The paper's campaign with its published table and no results of its own.
pub(super) fn published() -> Study {
    let text = include_str!("../../config/campaigns/andreaus-2020.toml");
    let spec: CampaignSpec = crate::config::parse_toml("c", text).expect("valid");
    Study::new(Configuration::load(spec).expect("loads"), &[])
}
