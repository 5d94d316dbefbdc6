//! Project chores: `cargo run -p xtask -- meshes` writes the meshes and cracks of `validation/`.
mod meshes;

use anyhow::{Result, bail};

fn main() -> Result<()> {
    match std::env::args().nth(1).as_deref() {
        Some("meshes") => meshes::write_all(),
        _ => bail!("give a chore: meshes"),
    }
}
