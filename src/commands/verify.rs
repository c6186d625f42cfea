//! `periscope verify`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::campaign::keys::CAMPAIGN_FILE;
use periscope::campaign::manifest::MANIFEST_FILE;
use periscope::campaign::{Campaign, Manifest, ManifestError, settings};
use periscope::pipeline::roots::{self, Root};
use periscope::store::{Digest, Shelf, StageId, verify as store};
use serde_json::{Value, json};

use super::output::{Format, Output, Rows, count, json, note, print, say};

/// Arguments of `verify`.
#[derive(Args)]
pub struct Verify {
    /// Campaign folder (checks raw files against the seal), or result folder (checks tables, records, lineages, and
    /// their raw files)
    dir: PathBuf,
    /// Read all raw files again, even those with the recorded size, times and inode
    #[arg(long)]
    rehash: bool,
    /// Campaign folder of a result folder, if it differs from that of the last run; may be given several times
    #[arg(long, value_name = "DIR")]
    campaign: Vec<PathBuf>,
    /// Delete damaged files in a result folder, so that the next run makes them again
    #[arg(long)]
    repair: bool,
    #[command(flatten)]
    output: Output,
}

/// The outcome to be printed.
#[derive(Default)]
struct Verification {
    /// Faults: file, what is wrong, how to fix it, and more for JSON.
    findings: Vec<Value>,
    /// Remarks that are no faults.
    notes: Vec<String>,
    /// What was checked, in words.
    looked_at: Vec<String>,
}

impl Verification {
    fn add(&mut self, file: &Path, what: impl ToString, fix: impl ToString) {
        let (what, fix) = (what.to_string(), fix.to_string());
        self.findings.push(json!({ "file": file, "what": what, "fix": fix }));
    }
}

/// The command.
pub fn verify(args: &Verify) -> Result<ExitCode> {
    let mut verification = Verification::default();
    if args.dir.join(".shelf").is_dir() {
        results(args, &mut verification)?;
    } else if args.dir.join("campaign.toml").is_file() {
        campaign(args, &mut verification)?;
    } else {
        bail!(
            "{}: neither a campaign folder (it has no campaign.toml) nor a result folder (it has no .shelf)",
            args.dir.display()
        );
    }
    let whole = verification.findings.is_empty();
    match args.output.format {
        Format::Table => tell(&args.dir, &verification)?,
        Format::Json => {
            let Verification { findings, notes, looked_at } = verification;
            print(json(&json!({ "ok": whole, "findings": findings, "notes": notes, "looked_at": looked_at }))?)?;
        }
        Format::Csv => {
            Rows::of(&["file", "tables", "what", "damage", "fix"], &verification.findings)?.print(Format::Csv)?;
        }
    }
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Prints the outcome as text.
fn tell(dir: &Path, verification: &Verification) -> Result<()> {
    for finding in &verification.findings {
        let text = |key: &str| finding[key].as_str().unwrap_or_default();
        let tables: Vec<&str> = finding["tables"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let of = if tables.is_empty() { String::new() } else { format!(" (table {})", tables.join(", ")) };
        say!("{}{of} {}\n    {}", text("file"), text("what"), text("fix"))?;
    }
    verification.notes.iter().for_each(|remark| note!("note: {remark}"));
    let outcome = match verification.findings.len() {
        0 => "no damage".to_owned(),
        faults => count(faults, "fault", "faults"),
    };
    let checked = match verification.looked_at.as_slice() {
        [] => String::new(),
        checked => format!("{}: ", checked.join("; ")),
    };
    say!("verified {}: {checked}{outcome}", dir.display())
}

/// Checks a campaign folder: its raw files against its seal.
fn campaign(args: &Verify, verification: &mut Verification) -> Result<()> {
    if args.repair || !args.campaign.is_empty() {
        bail!("--repair and --campaign are for result folders; {} is a campaign", args.dir.display());
    }
    let manifest = match Manifest::load(&args.dir) {
        Ok(manifest) => manifest,
        Err(error) => {
            damaged_manifest(error, verification)?;
            return Ok(());
        }
    };
    let Some(manifest) = manifest else {
        verification.add(
            Path::new("manifest.json"),
            "is missing: the campaign is not sealed",
            "`periscope seal` records the content of its files",
        );
        return Ok(());
    };
    settings(&args.dir, &manifest, verification)?;
    // Settings that cannot be read or applied any more are a finding already.
    let campaign = match Campaign::read(&args.dir) {
        Err(_) if !verification.findings.is_empty() => return Ok(()),
        campaign => campaign?,
    };
    raw_files(&campaign, &manifest, args.rehash, verification)?;
    let survey = match campaign.survey() {
        Err(_) if !verification.findings.is_empty() => return Ok(()),
        survey => survey?,
    };
    let new: Vec<String> = survey
        .files()
        .into_iter()
        .filter(|file| manifest.get(file).is_none())
        .map(|file| file.display().to_string())
        .collect();
    if !new.is_empty() {
        verification.notes.push(format!(
            "{} not in the seal; `periscope seal --update` adds them: {}",
            count(new.len(), "new file is", "new files are"),
            new.join(", ")
        ));
    }
    Ok(())
}

/// Checks campaign.toml and the tables that it names against the seal.
fn settings(root: &Path, seal: &Manifest, verification: &mut Verification) -> Result<()> {
    for change in settings::changes(root, seal.settings())? {
        verification.add(
            &root.join(&change.file),
            format!("changed since the campaign was sealed: {}", change.what),
            "restore it; if the change is meant, `periscope seal --update`",
        );
    }
    if !seal.settings().contains_key(CAMPAIGN_FILE) {
        let file = root.join(CAMPAIGN_FILE);
        verification.add(&file, "is not in the seal", "`periscope seal --update` takes it in");
    }
    verification.looked_at.push(count(seal.settings().len(), "file of settings", "files of settings"));
    Ok(())
}

/// Checks raw files against their records.
fn raw_files(campaign: &Campaign, manifest: &Manifest, rehash: bool, verification: &mut Verification) -> Result<()> {
    let audit = manifest.audit(campaign, rehash)?;
    for file in &audit.changed {
        verification.add(
            &campaign.path_of(file),
            "differs from the recorded content",
            "restore it; if the change is meant, seal the campaign anew and choose a new --out",
        );
    }
    for file in &audit.gone {
        verification.add(&campaign.path_of(file), "is gone", "restore it, or delete its line in the manifest");
    }
    if !audit.touched.is_empty() {
        verification.notes.push(format!(
            "{} of campaign {} with the recorded content, and another time or inode",
            count(audit.touched.len(), "raw file", "raw files"),
            campaign.name
        ));
    }
    let how = if rehash { "content" } else { "size, times and inode" };
    verification.looked_at.push(format!(
        "{} of campaign {} by {how}",
        count(manifest.iter().count(), "raw file", "raw files"),
        campaign.name
    ));
    Ok(())
}

/// Reports a damaged manifest as a finding; one that cannot be read is an error.
fn damaged_manifest(error: ManifestError, verification: &mut Verification) -> Result<()> {
    match &error {
        ManifestError::Damaged { file, .. } | ManifestError::Format { file, .. } => {
            verification.add(
                file,
                format!("is damaged: {error}"),
                "restore it, or take out what is damaged: raw files without a line are hashed anew",
            );
            Ok(())
        }
        _ => Err(error.into()),
    }
}

/// Checks a result folder.
fn results(args: &Verify, verification: &mut Verification) -> Result<()> {
    // For a repair nothing may read the folder meanwhile, so it is opened for writing.
    let shelf = if args.repair { Shelf::open(&args.dir)? } else { Shelf::look(&args.dir)? };
    let report = store::verify(&shelf)?;
    let counts = report.counts;
    verification.looked_at.push(format!(
        "{}, {}, {} of {} bytes, {}; {} followed",
        count(counts.tables, "table", "tables"),
        count(counts.parts, "part", "parts"),
        count(counts.files, "file", "files"),
        counts.bytes,
        count(counts.runs, "run", "runs"),
        count(counts.followed, "lineage", "lineages")
    ));
    verification.notes.extend(report.notes);
    for finding in &report.findings {
        verification.findings.push(serde_json::to_value(finding)?);
    }
    let campaigns = campaigns(args, report.run.as_ref().map(|run| run.campaigns.values()), verification);
    let (mut manifests, damaged) = notes(&shelf, verification)?;
    for campaign in &campaigns {
        // The seal decides if there is one; otherwise the notes of runs on raw files.
        match Manifest::load(&campaign.root) {
            Ok(sealed) => {
                if let Some(sealed) = &sealed {
                    settings(&campaign.root, sealed, verification)?;
                }
                let manifest = sealed.or_else(|| manifests.remove(&campaign.name));
                manifest.map_or(Ok(()), |manifest| raw_files(campaign, &manifest, args.rehash, verification))?;
            }
            Err(error) => damaged_manifest(error, verification)?,
        }
    }
    // Otherwise damaged files would be named twice.
    if verification.findings.is_empty() {
        let mut followed = BTreeMap::<&str, usize>::new();
        for (id, parts) in &report.sources {
            *followed.entry(&id.kind).or_default() += root(args, id, parts, &campaigns, &shelf, verification);
        }
        for (kind, parts) in followed.into_iter().filter(|(_, parts)| *parts > 0) {
            let parts = count(parts, &format!("part of {kind} follows"), &format!("parts of {kind} follow"));
            verification.looked_at.push(format!("{parts} from the raw files"));
        }
    }
    if args.repair {
        store::repair(&report.findings)?;
        damaged.iter().try_for_each(fs::remove_file)?;
        verification.notes.push("what is damaged is deleted; the next `run` makes it again".to_owned());
    }
    Ok(())
}

/// The notes of runs on raw files, by campaign, and the damaged files among them.
fn notes(shelf: &Shelf, verification: &mut Verification) -> Result<(BTreeMap<String, Manifest>, Vec<PathBuf>)> {
    let (mut manifests, mut damaged) = (BTreeMap::new(), Vec::new());
    let entries = match fs::read_dir(shelf.notes()) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok((manifests, damaged)),
        entries => entries.with_context(|| format!("cannot read {}", shelf.notes().display()))?,
    };
    for folder in entries.map(|entry| Ok(entry?.path())).collect::<io::Result<BTreeSet<_>>>()? {
        match Manifest::load(&folder) {
            Ok(manifest) => {
                let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
                manifests.extend(manifest.map(|manifest| (name, manifest)));
            }
            Err(error) => {
                damaged_manifest(error, verification)?;
                damaged.push(folder.join(MANIFEST_FILE));
            }
        }
    }
    Ok((manifests, damaged))
}

/// Checks the parts of a source against the raw files; returns how many follow from them.
fn root(
    args: &Verify,
    id: &StageId,
    parts: &[Digest],
    campaigns: &[Campaign],
    shelf: &Shelf,
    verification: &mut Verification,
) -> usize {
    match roots::follow(id, parts, campaigns, shelf) {
        Root::Followed { parts, other } => {
            if other > 0 {
                let others = count(other, "part of", "parts of");
                verification.notes.push(format!("raw files of {others} {} have changed or left the campaign", id.kind));
            }
            return parts;
        }
        Root::Unknown => {
            let parts = count(parts.len(), "part of", "parts of");
            verification.notes.push(format!("raw files of {parts} {} were not checked", id.kind));
        }
        Root::Refused(why) => verification.add(
            &args.dir,
            format!("cannot be traced to its raw files: {why}"),
            "fix the campaign, or give the right one with --campaign",
        ),
    }
    0
}

/// The given campaigns, or those of the last run.
fn campaigns<'a>(
    args: &Verify,
    named: Option<impl Iterator<Item = &'a PathBuf>>,
    verification: &mut Verification,
) -> Vec<Campaign> {
    let folders: Vec<PathBuf> = match named {
        _ if !args.campaign.is_empty() => args.campaign.clone(),
        Some(named) => named.cloned().collect(),
        None => Vec::new(),
    };
    if folders.is_empty() {
        verification
            .notes
            .push("RAW FILES WERE NOT CHECKED: no run record names a campaign; give --campaign DIR".to_owned());
    }
    let mut campaigns = Vec::new();
    for folder in folders {
        match Campaign::read(&folder) {
            Ok(campaign) => campaigns.push(campaign),
            Err(_) if let Err(changed) = settings::hold(&folder) => {
                verification.add(&folder.join(CAMPAIGN_FILE), "differs from the seal, and cannot be read", changed);
            }
            Err(error) => verification.notes.push(format!(
                "RAW FILES WERE NOT CHECKED: campaign {}: {error}; say where it is with --campaign DIR",
                folder.display()
            )),
        }
    }
    campaigns
}
