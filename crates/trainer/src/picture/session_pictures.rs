//! `pictures/` of a session folder.
use super::print::{Finish, encode_png, write_png};
use super::stage::Stage;
use super::views::View;
use anyhow::{Context, Result};
use osteotome_render::Renderer;
use std::path::Path;

/// A moment worth a picture.
struct Scene {
    file: &'static str,
    title: &'static str,
    time: f64,
    /// How far fragments are taken apart to be seen \[mm\].
    apart: f64,
    view: View,
}

/// Pixels across and down.
const SIZE: [usize; 2] = [1280, 720];

/// Writes the session's moments (before, first crack, break, after; those that came) into `folder`, opaque and transparent.
/// `progress` gets how many are done, and of how many.
///
/// # Errors
/// A recording that does not fit the bone, or whatever the file system says.
pub fn write_pictures(
    stage: &mut Stage,
    renderer: &mut Renderer,
    folder: &Path,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let scenes = scenes(stage);
    let n = 2 * scenes.len();
    for (k, scene) in scenes.iter().enumerate() {
        let moment = stage.at(scene.time, scene.apart)?;
        let camera = stage.camera(scene.view, SIZE[0] as f64 / SIZE[1] as f64);
        for (j, is_transparent) in [false, true].into_iter().enumerate() {
            let finish = Finish {
                size: SIZE,
                is_transparent,
                stereo: None,
            };
            let image = finish.print(renderer, &moment, &camera, scene.title);
            let suffix = if is_transparent { "_transparent" } else { "" };
            write_png(&folder.join(format!("{}{suffix}.png", scene.file)), &image)?;
            progress(2 * k + j + 1, n);
        }
    }
    Ok(())
}

/// A picture for a page.
pub struct Shot {
    /// What it shows.
    pub title: &'static str,
    /// When \[s\].
    pub time: f64,
    /// The file's bytes.
    pub png: Vec<u8>,
}

/// The session's moments, opaque, in the size for a page.
///
/// # Errors
/// A recording that does not fit the bone.
pub fn shots(stage: &mut Stage, renderer: &mut Renderer) -> Result<Vec<Shot>> {
    const SMALL: [usize; 2] = [800, 450];
    let moments = scenes(stage);
    let finish = Finish {
        size: SMALL,
        is_transparent: false,
        stereo: None,
    };
    let mut shoot = |scene: &Scene| {
        let moment = stage.at(scene.time, scene.apart)?;
        let camera = stage.camera(scene.view, SMALL[0] as f64 / SMALL[1] as f64);
        Ok(Shot {
            title: scene.title,
            time: scene.time,
            png: encode_png(&finish.print(renderer, &moment, &camera, scene.title))?,
        })
    };
    moments.iter().map(&mut shoot).collect()
}

fn scenes(stage: &Stage) -> Vec<Scene> {
    let recording = stage.recording();
    let end = recording.bone.last().map_or(0.0, |b| b.time);
    // The first recorded state of a generation from `from` on.
    let shown = |from: u64| {
        recording
            .bone
            .iter()
            .find(|b| b.generation >= from)
            .map(|b| b.time)
    };
    let first = recording.growth.iter().find(|g| g.generation > 0);
    let broken = recording.growth.iter().find(|g| g.severed);
    let mut scenes = vec![Scene {
        file: "1_before",
        title: "BEFORE",
        time: 0.0,
        apart: 0.0,
        view: View::Close,
    }];
    let mut push = |file, title, time: Option<f64>, view| {
        scenes.extend(time.map(|time| Scene {
            file,
            title,
            time,
            apart: 0.0,
            view,
        }));
    };
    push(
        "2_first_crack",
        "FIRST CRACK",
        first.and_then(|g| shown(g.generation)),
        View::Close,
    );
    push(
        "3_break",
        "BREAK",
        broken.and_then(|g| shown(g.generation)),
        View::Close,
    );
    // Bone springs back once the blades are out: taken apart, the fragments are seen.
    let (title, apart) = match broken {
        Some(_) => ("AFTER, FRAGMENTS MOVED 10 mm APART", 10.0),
        None => ("END", 0.0),
    };
    scenes.push(Scene {
        file: "4_after",
        title,
        time: end,
        apart,
        view: View::Close,
    });
    scenes
}
