//! `render`: pictures and films of a recorded session.
use crate::cli::{Failure, RenderArgs};
use crate::commands;
use crate::picture::{Finish, Orbit, Stage, Video, write_png};
use crate::session::Recording;
use crate::talk::{self, Progress};
use anyhow::{Context, Result, anyhow, bail};
use osteotome_render::{Camera, Renderer};
use std::path::Path;

/// A picture at one time, or a film of the whole session.
pub fn render(args: &RenderArgs) -> Result<(), Failure> {
    let recording = Recording::read(&args.session).map_err(Failure::Input)?;
    let scenario = &recording.scenario.scenario;
    let seconds = recording.seconds(scenario);
    if let Some(at) = args.at
        && !(0.0..=seconds).contains(&at)
    {
        return Err(Failure::Input(anyhow!(
            "--at {at}: the session lasts {seconds:.2} s; give a time within it"
        )));
    }
    let output = args.output.as_deref().or(args.video.as_deref());
    output.map_or(Ok(()), check_place).map_err(Failure::Input)?;
    if args.video.is_some() && args.size.iter().any(|n| n % 2 == 1) {
        let [w, h] = args.size;
        return Err(Failure::Input(anyhow!(
            "--size {w}x{h}: a film needs even numbers"
        )));
    }
    let mut renderer = renderer(args).map_err(Failure::Work)?;
    let film = args
        .video
        .as_deref()
        .map(|path| Video::start(path, args.size));
    let film = film.transpose().map_err(Failure::Work)?;
    let prepared = commands::prepare_recorded(&recording, &args.session)?;
    let named = || args.session.display().to_string();
    let mut stage = Stage::new(&prepared, &recording)
        .with_context(named)
        .map_err(Failure::Input)?;
    stage.show_head(args.head);
    stage.show_tools(!args.no_tools);
    stage.look_from(args.views.map(usize::from));
    let work = match film {
        Some(film) => shoot(&mut stage, &mut renderer, args, film, seconds),
        None => picture(&mut stage, &mut renderer, args),
    };
    work.with_context(named).map_err(Failure::Work)
}

fn finish(args: &RenderArgs) -> Finish {
    Finish {
        size: args.size,
        is_transparent: args.transparent,
        stereo: args.stereo,
    }
}

fn renderer(args: &RenderArgs) -> Result<Renderer> {
    if args.gpu {
        return Renderer::device()
            .map_err(|why| anyhow!("--gpu: {why}; without --gpu the processor draws"));
    }
    Ok(if args.cpu {
        Renderer::processor()
    } else {
        Renderer::fastest()
    })
}

/// From where it is looked at.
fn camera(stage: &Stage, args: &RenderArgs) -> Camera {
    let named = stage.camera(args.view, args.size[0] as f64 / args.size[1] as f64);
    let mut orbit = Orbit::of(&named);
    if let Some(target) = args.target {
        orbit.look_at(target.into());
    }
    let [right, up] = args.turn.unwrap_or_default().map(f64::to_radians);
    orbit.turn(right, up);
    orbit.zoom(1.0 / args.zoom);
    orbit.camera()
}

fn picture(stage: &mut Stage, renderer: &mut Renderer, args: &RenderArgs) -> Result<()> {
    let (Some(at), Some(path)) = (args.at, &args.output) else {
        bail!("--at and -o go together");
    };
    let moment = stage.at(at, args.apart)?;
    let camera = camera(stage, args);
    let image = finish(args).print(renderer, &moment, &camera, "");
    write_png(path, &image)?;
    talk::say(&format!(
        "Picture: {}, drawn on {}",
        path.display(),
        renderer.place()
    ));
    Ok(())
}

fn shoot(
    stage: &mut Stage,
    renderer: &mut Renderer,
    args: &RenderArgs,
    mut film: Video,
    seconds: f64,
) -> Result<()> {
    let n = (seconds * f64::from(Video::RATE)).ceil().max(1.0) as u64;
    let camera = camera(stage, args);
    let mut bar = Progress::new("Filming", n);
    for k in 0..n {
        let time = k as f64 / f64::from(Video::RATE);
        let moment = stage.at(time.min(seconds), args.apart)?;
        film.push(&finish(args).print(renderer, &moment, &camera, ""))?;
        bar.set(k + 1, format!("{time:.1} s"));
    }
    film.finish()?;
    bar.done();
    talk::say(&format!(
        "Film of {n} frames, drawn on {}",
        renderer.place()
    ));
    Ok(())
}

/// Whether a file can be written there.
pub fn check_place(path: &Path) -> Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if folder.is_some_and(|f| !f.is_dir()) || path.is_dir() {
        bail!(
            "{}: no file can be written there; give one in a folder that exists",
            path.display()
        );
    }
    Ok(())
}
