//! `osteotome train`: the simulator's window.
//!
//! ```text
//! loops -> recorder's rings -> Feed -> Live -> Window (plots, gauges)
//!                                          \-> Eye (scene, on its own low-priority threads) -> Window
//! ```
//! Nothing flows back into the loops but [`Control`](crate::loops::Control) (pause, stop) and where mouse and keyboard want the
//! hands; both are read without waiting. So a slow window, or none at all, is nothing to the haptic loop.
mod app;
mod catalogue;
mod coach;
mod conductor;
mod dresser;
mod eye;
mod guide;
mod live;
mod look_back;
mod mouse_hands;
mod panels;
mod picker;
mod planner;
mod plots;
mod rehearsal;
mod scene;
mod settings;
mod shortcuts;
#[cfg(test)]
mod soak;
mod style;
mod teacher;

use crate::cli::{Failure, TrainArgs};
use anyhow::{Context, Result, anyhow};
use app::Window;
use eframe::egui::{ViewportBuilder, vec2};
use look_back::LookBack;
use rehearsal::Rehearsal;
use std::path::Path;

/// Whether there is a display to open a window on.
pub fn has_display() -> bool {
    if cfg!(any(target_os = "windows", target_os = "macos")) {
        return true;
    }
    let is_set = |name| std::env::var_os(name).is_some_and(|v| !v.is_empty());
    is_set("DISPLAY") || is_set("WAYLAND_DISPLAY")
}

/// `train`: opens the window and stays until it is closed.
pub fn train(args: &TrainArgs) -> Result<(), Failure> {
    if let Some(scenario) = &args.scenario {
        let name = scenario.to_string_lossy();
        catalogue::load(&name, &args.set).map_err(Failure::Input)?;
    }
    if let Some(path) = &args.from {
        let back = LookBack::read(path).map_err(Failure::Input)?;
        let moment = args.at.map(|at| back.moment_at(at)).transpose();
        moment
            .with_context(|| path.display().to_string())
            .map_err(Failure::Input)?;
    }
    let rehearsal = args.rehearse.as_deref().map(Rehearsal::read).transpose();
    let rehearsal = rehearsal.map_err(Failure::Input)?;
    if !has_display() {
        return Err(Failure::Work(no_window("there is no display")));
    }
    let failed = rehearsal.as_ref().map(Rehearsal::failure);
    open(args, rehearsal).map_err(Failure::Work)?;
    match failed.and_then(|f| f.take()) {
        Some(text) => Err(Failure::Work(anyhow!("rehearsal: {text}"))),
        None => Ok(()),
    }
}

fn no_window(why: &str) -> anyhow::Error {
    anyhow!(
        "{why}, so no window can be opened; use `osteotome demo`, or `osteotome run SCENARIO --out DIR`, and `osteotome render` for pictures"
    )
}

fn open(args: &TrainArgs, rehearsal: Option<Rehearsal>) -> Result<()> {
    let options = eframe::NativeOptions {
        viewport: ViewportBuilder::default()
            .with_title("Osteotome")
            .with_app_id("osteotome")
            .with_inner_size(vec2(1280.0, 720.0))
            .with_min_inner_size(vec2(900.0, 560.0)),
        ..Default::default()
    };
    let folder = settings::folder();
    let scenario = args.scenario.as_deref().map(Path::to_string_lossy);
    let result = eframe::run_native(
        "osteotome",
        options,
        Box::new(|cc| {
            style::set(&cc.egui_ctx);
            if let Some(rehearsal) = rehearsal {
                cc.egui_ctx.enable_accesskit();
                cc.egui_ctx.add_plugin(rehearsal);
            }
            let window = Window::new(&cc.egui_ctx, folder, scenario.as_deref(), args);
            Ok(Box::new(window?))
        }),
    );
    result.map_err(|error| no_window(&format!("{error}").replace('\n', " ")))
}
