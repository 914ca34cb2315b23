//! `mcvr schema`

use std::io::Write;

#[derive(clap::Args)]
#[command(after_help = "Example:\n  mcvr schema > scene.schema.json\n\n\
    Editors with a TOML language server complete and check a scene file that starts with\n  #:schema scene.schema.json")]
pub struct Args {}

pub fn run(_: &Args) -> anyhow::Result<()> {
    let mut text = serde_json::to_string_pretty(&mcvr::SceneFile::schema())?;
    text.push('\n');
    Ok(super::outputs::stdout().write_all(text.as_bytes())?)
}
