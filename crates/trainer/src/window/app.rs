//! The window: what it holds, and what happens in a frame.
use super::catalogue::Leading;
use super::conductor::{Conductor, Kept, Phase, Ready, Setup};
use super::eye::{Eye, Look};
use super::guide::Guide;
use super::live::{SharedLive, look};
use super::mouse_hands::{Held, MouseHands};
use super::picker::{self, Picker};
use super::planner::{self, Planner};
use super::settings::Settings;
use super::shortcuts::{self, Command};
use super::teacher::Teacher;
use super::{catalogue, panels, scene, teacher};
use crate::cli::TrainArgs;
use crate::picture::{Orbit, StereoMode, View};
use anyhow::Result;
use eframe::egui::{self, Context, TextureHandle, Ui, ViewportCommand};
use osteotome_devices::Binding;
use osteotome_mechanics::geometry::Pose;
use osteotome_render::Camera;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Between two looks at a running session.
const FRAME: Duration = Duration::from_millis(33);
/// A notice stays for so long.
const NOTICE: Duration = Duration::from_secs(12);
/// Stereo modes in the order of the picker.
pub const STEREO: [(Option<StereoMode>, &str); 5] = [
    (None, "Off"),
    (Some(StereoMode::SideBySide), "Side by side"),
    (Some(StereoMode::OverUnder), "Over and under"),
    (Some(StereoMode::Interlaced), "Row interlaced"),
    (Some(StereoMode::Anaglyph), "Red and cyan"),
];

/// The window's state.
pub struct Window {
    pub(super) conductor: Conductor,
    pub(super) live: SharedLive,
    pub(super) settings: Settings,
    pub(super) hands: MouseHands,
    pub(super) leading: [Leading; 2],
    pub(super) devices: Devices,
    /// A file's path being typed.
    pub(super) path: String,
    /// The list of files, where it is open.
    pub(super) picker: Option<Picker>,
    pub(super) scenario: String,
    pub(super) shows_help: bool,
    pub(super) summary: Option<Kept>,
    pub(super) notice: Option<(String, Instant)>,
    pub(super) apart: f64,
    pub(super) view: ViewState,
    pub(super) teacher: Teacher,
    pub(super) planner: Planner,
    /// The moment of a recording that is being read from which it then goes on \[s\].
    goes_on_at: Option<f64>,
    eye: Eye,
    folder: Option<PathBuf>,
    is_closing: bool,
}

/// From where the scene is seen, and what was seen last.
#[derive(Default)]
pub struct ViewState {
    /// `None` until there is a patient.
    pub orbit: Option<Orbit>,
    /// The saved view wished for, once the scene's size is known.
    pub wished: Option<View>,
    /// Whether it follows the chisels.
    pub is_first_person: bool,
    /// Whether the panel on the left shows what is set of it.
    pub is_being_set: bool,
    /// The newest picture.
    pub texture: Option<TextureHandle>,
    /// From where that was taken.
    pub camera: Option<Camera>,
    /// How long it took \[ms\].
    pub ms: f64,
    patient: Option<Arc<Ready>>,
}

/// Devices that have been found.
#[derive(Default)]
pub struct Devices {
    /// They.
    pub found: Vec<Binding>,
    search: Option<JoinHandle<Vec<Binding>>>,
}

impl Devices {
    /// Looks for them anew, on a thread: drivers take their time.
    pub fn seek(&mut self) {
        let thread = Builder::new().name("seek".into());
        // Without a thread there is nothing to be found.
        self.search = thread.spawn(catalogue::find_devices).ok();
    }

    /// Whether that is under way.
    pub fn is_seeking(&self) -> bool {
        self.search.is_some()
    }

    fn poll(&mut self) -> bool {
        if !self.search.as_ref().is_some_and(JoinHandle::is_finished) {
            return false;
        }
        // A driver that has panicked has found nothing.
        let found = self.search.take().and_then(|s| s.join().ok());
        self.found = found.unwrap_or_default();
        true
    }
}

impl Window {
    /// Opens on what was trained last, or on `scenario`.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn new(
        ctx: &Context,
        folder: Option<PathBuf>,
        scenario: Option<&str>,
        args: &TrainArgs,
    ) -> Result<Self> {
        let (mut settings, wrong) = folder
            .as_deref()
            .map_or_else(Default::default, Settings::read);
        if let Some(out) = &args.out {
            settings.sessions.clone_from(out);
        }
        ctx.set_zoom_factor(settings.zoom);
        let live = SharedLive::default();
        let wake = ctx.clone();
        let eye = Eye::open(live.clone(), move || wake.request_repaint())?;
        let still = [Pose::identity(); 2];
        let mut window = Self {
            conductor: Conductor::new(live.clone(), args.set.clone()),
            live,
            hands: MouseHands::new([None, None], still),
            leading: settings.hands.each_ref().map(|h| Leading::read(h)),
            devices: Devices::default(),
            path: String::new(),
            picker: None,
            scenario: String::new(),
            shows_help: false,
            summary: None,
            notice: None,
            apart: 0.0,
            view: ViewState::default(),
            teacher: Teacher::default(),
            planner: Planner::default(),
            goes_on_at: args.at,
            eye,
            folder,
            is_closing: false,
            settings,
        };
        wrong.into_iter().for_each(|text| window.notify(text));
        let is_new = !window.settings.has_been_guided && args.rehearse.is_none();
        window.teacher.guide = is_new.then(Guide::new);
        let name = scenario.map_or_else(|| window.settings.scenario.clone(), str::to_owned);
        match &args.from {
            Some(path) => window.look_back(path),
            None => window.select(&name),
        }
        Ok(window)
    }

    /// Says something at the window's foot.
    pub fn notify(&mut self, text: String) {
        self.notice = Some((text, Instant::now()));
    }

    /// Goes over to a scenario.
    pub fn select(&mut self, name: &str) {
        let is_shipped = catalogue::SHIPPED.iter().any(|s| s.0 == name);
        let file = (!is_shipped).then(|| std::path::absolute(name).unwrap_or_else(|_| name.into()));
        let name = match &file {
            Some(file) => {
                self.settings.remember(file);
                file.to_string_lossy().into_owned()
            }
            None => name.to_owned(),
        };
        self.settings.scenario.clone_from(&name);
        self.scenario.clone_from(&name);
        self.summary = None;
        self.teacher.back = None;
        self.conductor.select(&name);
    }

    fn setup(&self) -> Setup {
        Setup {
            hands: self.leading.clone(),
            sessions: self.settings.sessions.clone(),
            draws: self.settings.draws_pictures,
            profile: Some(self.settings.profile.clone()).filter(|p| !p.is_empty()),
        }
    }

    /// Does what a key or a button asks for.
    pub fn obey(&mut self, ctx: &Context, command: Command) {
        let phase = self.conductor.phase();
        match command {
            Command::Go => self.go(phase),
            Command::Finish => self.conductor.finish(),
            Command::Reset => self.reset(),
            Command::Retry => self.retry(phase),
            Command::View(view) => self.see(view),
            Command::FirstPerson => self.view.is_first_person = true,
            Command::Transparent => self.settings.is_transparent ^= true,
            Command::Loads => self.settings.shows_loads ^= true,
            Command::Head => self.settings.shows_head ^= true,
            Command::Stereo => {
                let now = STEREO.iter().position(|s| s.0 == self.settings.stereo);
                self.settings.stereo = STEREO[(now.unwrap_or(0) + 1) % STEREO.len()].0;
            }
            Command::Hold(held) => self.hands.hold(held),
            Command::GoBack => self.hands.go_back(),
            Command::FullScreen => {
                let is_full = ctx.input(|i| i.viewport().fullscreen.unwrap_or(false));
                ctx.send_viewport_cmd(ViewportCommand::Fullscreen(!is_full));
            }
            Command::Help => self.shows_help ^= true,
            Command::Dismiss => {
                let shown = std::mem::take(&mut self.shows_help)
                    || self.picker.take().is_some()
                    || teacher::dismiss(self);
                if !shown && self.summary.take().is_none() {
                    self.hands.hold(Held::None);
                }
            }
        }
    }

    fn go(&mut self, phase: Phase) {
        match phase {
            Phase::Ready => self.retry(phase),
            Phase::Running => self.conductor.pause(true),
            Phase::Paused => self.conductor.pause(false),
            Phase::Empty | Phase::Preparing | Phase::Recomputing | Phase::Keeping => {}
        }
    }

    fn retry(&mut self, phase: Phase) {
        if matches!(phase, Phase::Empty | Phase::Preparing) {
            return;
        }
        self.summary = None;
        self.teacher.back = None;
        self.conductor.start(self.setup());
    }

    /// Reads a recorded session to be looked at.
    pub fn look_back(&mut self, path: &Path) {
        self.summary = None;
        self.conductor.open(path);
    }

    /// Goes on live from the moment that is looked at.
    pub fn retry_from_here(&mut self) {
        let Some(back) = &self.teacher.back else {
            return;
        };
        match back.moment() {
            Ok(moment) => {
                self.teacher.back = None;
                self.conductor.go_on_from(self.setup(), moment);
            }
            Err(error) => self.notify(format!("{error:#}")),
        }
    }

    /// Back to the patient as at the beginning.
    pub fn close_look_back(&mut self) {
        self.teacher.back = None;
        self.conductor.reset();
    }

    fn reset(&mut self) {
        self.summary = None;
        self.teacher.back = None;
        self.conductor.reset();
    }

    /// Takes a saved view.
    pub fn see(&mut self, view: View) {
        self.settings.view = Some(view);
        self.view.wished = Some(view);
        self.view.is_first_person = false;
    }

    /// What the other threads have done since the last frame.
    fn poll(&mut self, ctx: &Context) {
        self.conductor.poll();
        if let Some(text) = self.conductor.take_notice() {
            self.notify(text);
        }
        if let Some(kept) = self.conductor.take_kept() {
            self.notify(match &kept.fault {
                None => format!("Session kept in {}", kept.folder.display()),
                Some(fault) => fault.clone(),
            });
            self.summary = kept.is_last_word.then_some(kept);
        }
        if let Some(back) = self.conductor.take_opened() {
            back.show(&self.live);
            self.notify(format!("Looking back at {}", back.path.display()));
            self.teacher.back = Some(back);
            teacher::first_view(self);
            if let Some(at) = self.goes_on_at.take() {
                self.teacher.back.iter_mut().for_each(|b| _ = b.go_to(at));
                self.retry_from_here();
            }
        }
        let guides = self.conductor.take_guides();
        if guides.iter().any(Option::is_some) || self.conductor.phase() == Phase::Preparing {
            let start = self.conductor.start_of_hands();
            self.hands = MouseHands::new(guides, start.unwrap_or([Pose::identity(); 2]));
        }
        if self.devices.poll() {
            let n = self.devices.found.len();
            self.notify(match n {
                0 => "No haptic device was found; `osteotome devices` says what is missing".into(),
                _ => format!("{n} haptic device(s) found"),
            });
        }
        if let Some(seen) = self.eye.take() {
            match seen.fault {
                Some(fault) => self.notify(format!("The scene cannot be drawn: {fault}")),
                None => self.show(ctx, seen),
            }
        }
        if self.notice.as_ref().is_some_and(|n| n.1.elapsed() > NOTICE) {
            self.notice = None;
        }
    }

    fn show(&mut self, ctx: &Context, seen: super::eye::Seen) {
        self.view.camera = Some(seen.camera);
        self.view.ms = seen.ms;
        match &mut self.view.texture {
            Some(texture) => texture.set(seen.image, egui::TextureOptions::LINEAR),
            None => {
                let options = egui::TextureOptions::LINEAR;
                self.view.texture = Some(ctx.load_texture("scene", seen.image, options));
            }
        }
    }

    /// Tells the eye what to look at; `size` in pixels.
    pub(super) fn look(&mut self, size: [usize; 2]) {
        let Some(ready) = self.conductor.ready().cloned() else {
            return;
        };
        let aspect = size[0] as f64 / size[1].max(1) as f64;
        let is_other = |p: &Arc<Ready>| !Arc::ptr_eq(p, &ready);
        if self.view.patient.as_ref().is_none_or(is_other) {
            self.view.wished = self.settings.view.or(Some(View::Close));
            self.view.patient = Some(ready.clone());
        }
        if let Some(view) = self.view.wished.take() {
            self.view.orbit = Some(Orbit::of(&view.camera(&ready.prepared, aspect)));
        }
        if self.view.is_first_person {
            let tools = look(&self.live).hands.map(|h| h.hands.map(|h| h.tool_pose));
            self.view.orbit = Some(Orbit::behind(&tools.unwrap_or(ready.start)));
        }
        let Some(orbit) = &self.view.orbit else {
            return;
        };
        let wished = Look {
            camera: orbit.camera(),
            size,
            is_transparent: self.settings.is_transparent,
            shows_loads: self.settings.shows_loads,
            shows_head: self.settings.shows_head,
            apart: self.apart,
            stereo: self.settings.stereo,
        };
        self.eye.wish(wished, &ready);
    }

    /// A session that runs is ended and kept before the window closes.
    fn close(&mut self, ctx: &Context) {
        let phase = self.conductor.phase();
        let is_busy = matches!(
            phase,
            Phase::Running | Phase::Paused | Phase::Recomputing | Phase::Keeping
        );
        if ctx.input(|i| i.viewport().close_requested()) {
            self.is_closing = true;
            self.conductor.reset();
            if is_busy {
                ctx.send_viewport_cmd(ViewportCommand::CancelClose);
            } else {
                self.keep_settings(ctx);
            }
        } else if self.is_closing && !is_busy {
            ctx.send_viewport_cmd(ViewportCommand::Close);
        }
    }

    fn keep_settings(&mut self, ctx: &Context) {
        self.settings.zoom = ctx.zoom_factor();
        self.settings.hands = self.leading.each_ref().map(Leading::name);
        if let Some(folder) = &self.folder
            && let Err(error) = self.settings.write(folder)
        {
            self.notify(format!("{error:#}"));
        }
    }

    /// A frame.
    pub fn frame(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        self.poll(&ctx);
        self.close(&ctx);
        if !ctx.text_edit_focused() {
            for command in ctx.input_mut(shortcuts::commands) {
                self.obey(&ctx, command);
            }
        }
        for file in ctx.input(|i| i.raw.dropped_files.clone()) {
            self.path = file.path().to_string_lossy().into_owned();
            panels::open_path(self);
        }
        teacher::tick(self, &ctx);
        panels::bar(self, ui);
        panels::foot(self, ui);
        panels::left(self, ui);
        panels::right(self, ui);
        panels::plots(self, ui);
        teacher::strip(self, ui);
        scene::centre(self, ui);
        planner::panel(self, &ctx);
        panels::help(self, &ctx);
        picker::show(self, &ctx);
        panels::summary(self, &ctx);
        teacher::history(self, &ctx);
        let is_moving = !matches!(self.conductor.phase(), Phase::Ready | Phase::Empty);
        if is_moving || self.devices.is_seeking() || self.is_closing {
            ctx.request_repaint_after(FRAME);
        } else if self.notice.is_some() {
            ctx.request_repaint_after(Duration::from_secs(1));
        }
    }
}

impl eframe::App for Window {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        self.frame(ui);
    }
}
