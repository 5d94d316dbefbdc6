//! What teaches, drawn: hints, the guided first run, profiles, and the strip on which a recorded session is scrubbed.
use super::app::Window;
use super::coach::{Coach, Hint, Hints, Verdict};
use super::conductor::Phase;
use super::guide::{Guide, Lesson, Sight};
use super::live::look;
use super::look_back::{LookBack, SPEEDS};
use super::mouse_hands::Held;
use super::panels::{self, frame, sheet, wide_combo};
use super::{catalogue::Leading, plots, style};
use crate::picture::View;
use crate::profiles::{self, Entry};
use eframe::egui::{
    self, Button, Color32, ComboBox, Context, Margin, Painter, Panel, Pos2, Rect, RichText,
    ScrollArea, Shape, Slider, Stroke, Ui, vec2,
};
use egui_plot::{Line, Plot, PlotPoints};
use osteotome_mechanics::geometry::Vec3;
use osteotome_render::Camera;

/// What teaches, in the window.
#[derive(Default)]
pub struct Teacher {
    coach: Option<Coach>,
    /// The guided first run, while it goes on.
    pub guide: Option<Guide>,
    /// The recorded session that is looked at.
    pub back: Option<LookBack>,
    /// Names of the profiles there are.
    names: Vec<String>,
    has_listed: bool,
    /// A name being typed.
    new_name: String,
    history: Option<History>,
}

struct History {
    name: String,
    entries: Vec<Entry>,
    /// Whether the next click deletes it all.
    is_deleting: bool,
}

/// Whether hints are shown at all.
fn may_hint(w: &Window) -> bool {
    !is_exam(w) && w.settings.shows_hints
}

/// By the window's switch, or by the scenario.
pub fn is_exam(w: &Window) -> bool {
    let by_scenario = w.conductor.ready().is_some_and(|r| r.scenario.exam);
    w.settings.is_exam || by_scenario
}

/// Before anything is drawn: time of a session that is looked at goes on, and the guide sees what is done.
pub fn tick(w: &mut Window, ctx: &Context) {
    if let Some(back) = &mut w.teacher.back {
        let dt = ctx.input(|i| f64::from(i.stable_dt.min(0.1)));
        if back.tick(dt) {
            back.show(&w.live);
        }
        if back.is_playing {
            ctx.request_repaint();
        }
    }
    let is_running = w.conductor.phase() == Phase::Running;
    let by_device = w.leading.iter().any(|l| matches!(l, Leading::Device(_)));
    let holds = w.hands.held != Held::None || by_device;
    if let Some(guide) = &mut w.teacher.guide
        && w.teacher.back.is_none()
    {
        let live = look(&w.live);
        guide.see(&Sight {
            is_running,
            holds,
            live: &live,
        });
    }
}

fn color(verdict: Verdict) -> Color32 {
    match verdict {
        Verdict::Good => style::GOOD,
        Verdict::Fair => style::FAIR,
        Verdict::Bad => style::BAD,
    }
}

/// What the coach says now; nothing in an exam, or where it is switched off.
pub fn hints(w: &mut Window) -> Option<Hints> {
    let ready = w.conductor.ready()?.clone();
    if w.teacher.coach.as_ref().is_none_or(|c| !c.is_for(&ready)) {
        w.teacher.coach = Some(Coach::new(&ready));
    }
    if !may_hint(w) {
        return None;
    }
    let hints = w.teacher.coach.as_mut()?.hints(&look(&w.live));
    Some(hints)
}

/// Distance to the canal, in the colour of its verdict.
pub fn distance(hint: Option<&Hint>) -> RichText {
    match hint {
        Some(h) => RichText::new(format!("{:.1} mm", h.value)).color(color(h.verdict)),
        None => RichText::new("not known").color(style::WEAK),
    }
}

/// A load against the device's limit, with a mark at its target.
pub fn load(ui: &mut Ui, name: &str, hint: &Hint, unit: &str, share: f64, target: f64) {
    let text = format!("{:.0} of {:.0} {unit}", hint.value, hint.good);
    plots::bar(ui, name, &text, share, color(hint.verdict), target);
}

/// Switches of the coach, below those of the view.
pub fn switches(w: &mut Window, ui: &mut Ui) {
    let by_scenario = w.conductor.ready().is_some_and(|r| r.scenario.exam);
    ui.add_enabled_ui(!by_scenario, |ui| {
        ui.checkbox(&mut w.settings.is_exam, "Exam: no hints");
    });
    let may = !is_exam(w);
    ui.add_enabled_ui(may, |ui| {
        ui.horizontal(|ui| {
            ui.checkbox(&mut w.settings.shows_hints, "Hints");
            ui.checkbox(&mut w.settings.shows_plan, "Planned plane");
        });
        if ui.button("Guided first run").clicked() {
            w.teacher.guide = Some(Guide::new());
        }
    });
}

/// The planned plane's outline over the scene.
pub fn plan(w: &Window, painter: &Painter, rect: Rect, camera: &Camera) {
    if is_exam(w) || !w.settings.shows_plan {
        return;
    }
    let Some(coach) = &w.teacher.coach else {
        return;
    };
    let corners = coach.plan();
    let on_screen = |p: &Vec3| project(camera, rect, p);
    let Some(points) = corners.iter().map(on_screen).collect::<Option<Vec<_>>>() else {
        return;
    };
    if points.len() < 4 {
        return;
    }
    let line = Color32::from_rgb(120, 200, 255);
    let fill = line.gamma_multiply(0.08);
    painter.add(Shape::convex_polygon(points.clone(), fill, Stroke::NONE));
    let closed: Vec<Pos2> = points.iter().chain(points.first()).copied().collect();
    painter.extend(Shape::dashed_line(
        &closed,
        Stroke::new(1.5, line),
        8.0,
        5.0,
    ));
    let font = egui::FontId::proportional(11.0);
    let place = egui::Align2::LEFT_BOTTOM;
    painter.text(points[1], place, "planned plane", font, line);
}

/// Where a point is on the picture; nothing behind the eye.
fn project(camera: &Camera, rect: Rect, p: &Vec3) -> Option<Pos2> {
    let way = [0, 1, 2].map(|k| p[k] as f32 - camera.eye[k]);
    let along = camera
        .axes
        .map(|a| (0..3).map(|k| a[k] * way[k]).sum::<f32>());
    let [right, up, forward] = along;
    let scale = 0.5 * rect.height() / (forward * camera.tangent);
    (forward > 1.0).then(|| rect.center() + vec2(right * scale, -up * scale))
}

/// The guided first run, over the scene.
pub fn guide(w: &mut Window, ui: &mut Ui, rect: Rect) {
    if is_exam(w) || w.teacher.back.is_some() {
        return;
    }
    let Some(guide) = &w.teacher.guide else {
        return;
    };
    let lesson = guide.lesson();
    let (n, of) = (guide.n_done(), Lesson::ALL.len());
    let place = Rect::from_min_size(
        rect.left_bottom() + vec2(14.0, -128.0),
        vec2(rect.width().min(400.0) - 20.0, 84.0),
    );
    let mut is_over = false;
    ui.scope_builder(egui::UiBuilder::new().max_rect(place), |ui| {
        egui::Frame::new()
            .fill(style::CARD.gamma_multiply(0.94))
            .corner_radius(egui::CornerRadius::same(8))
            .inner_margin(Margin::same(10))
            .show(ui, |ui| {
                ui.horizontal(|ui| {
                    let title = match lesson {
                        Lesson::Done => "First run: done".to_owned(),
                        _ => format!("First run: {} of {of}", n + 1),
                    };
                    ui.label(RichText::new(title).small().strong().color(style::WEAK));
                    let right = egui::Layout::right_to_left(egui::Align::Center);
                    ui.with_layout(right, |ui| {
                        let word = if lesson == Lesson::Done {
                            "Close"
                        } else {
                            "Leave out"
                        };
                        is_over = ui.small_button(word).clicked();
                    });
                });
                ui.label(lesson.words());
            });
    });
    if is_over {
        w.teacher.guide = None;
        w.settings.has_been_guided = true;
    }
}

/// Time of the recorded session that is looked at, and where to go on from.
pub fn strip(w: &mut Window, ui: &mut Ui) {
    if w.teacher.back.is_none() {
        return;
    }
    let (mut is_closed, mut asks_retry) = (false, false);
    Panel::bottom("look back")
        .exact_size(40.0)
        .frame(frame(Margin::symmetric(12, 0)).fill(style::CARD))
        .show(ui, |ui| {
            ui.horizontal_centered(|ui| {
                let Some(back) = &mut w.teacher.back else { return };
                let mut time = back.time;
                if ui.button(if back.is_playing { "Halt" } else { "Play" }).clicked() {
                    back.is_playing ^= true;
                    if back.is_playing && back.time >= back.lasts {
                        time = 0.0;
                    }
                }
                for (word, is_next, hint) in [
                    ("<", false, "To the mark before"),
                    (">", true, "To the next mark"),
                ] {
                    let mark = back.mark(is_next);
                    let button = ui.add_enabled(mark.is_some(), Button::new(word));
                    if button.on_hover_text(hint).clicked() {
                        time = mark.unwrap_or(time);
                    }
                }
                marks(back, ui, &mut time);
                ComboBox::from_id_salt("pace")
                    .selected_text(format!("x {}", back.speed))
                    .width(56.0)
                    .show_ui(ui, |ui| {
                        for speed in SPEEDS {
                            ui.selectable_value(&mut back.speed, speed, format!("x {speed}"));
                        }
                    });
                ui.spacing_mut().slider_width = (ui.available_width() - 300.0).max(60.0);
                let slider = Slider::new(&mut time, 0.0..=back.lasts)
                    .suffix(" s")
                    .fixed_decimals(2);
                ui.add(slider);
                let retry = Button::new(RichText::new("Re-try from here").color(Color32::WHITE));
                let retry = ui.add_enabled(time > 0.0, retry.fill(style::ACCENT));
                let hint = "Recomputes the session up to this moment, then goes on with the hands chosen on the left";
                asks_retry = retry.on_hover_text(hint).clicked();
                is_closed = ui.button("Close").clicked();
                if back.go_to(time) {
                    back.show(&w.live);
                }
            });
        });
    if asks_retry {
        w.retry_from_here();
    } else if is_closed {
        w.close_look_back();
    }
}

fn marks(back: &LookBack, ui: &mut Ui, time: &mut f64) {
    ComboBox::from_id_salt("marks")
        .selected_text("Marks")
        .width(70.0)
        .show_ui(ui, |ui| {
            for (at, what) in &back.marks {
                let text = format!("{at:.2} s  {what}");
                if ui.selectable_label(false, text).clicked() {
                    *time = *at;
                }
            }
        });
}

/// Who trains, and the way to their history.
pub fn profile(w: &mut Window, ui: &mut Ui) {
    if !w.teacher.has_listed {
        list(w);
    }
    let nobody = "Nobody: no history";
    let now = w.settings.profile.clone();
    let shown = if now.is_empty() { "Nobody" } else { &now };
    ui.horizontal(|ui| {
        let combo = wide_combo("profile", shown, ui).width(ui.available_width() - 88.0);
        combo.show_ui(ui, |ui| {
            ui.selectable_value(&mut w.settings.profile, String::new(), nobody);
            for name in &w.teacher.names {
                ui.selectable_value(&mut w.settings.profile, name.clone(), name);
            }
        });
        let can = !w.settings.profile.is_empty();
        if ui.add_enabled(can, Button::new("History")).clicked() {
            open_history(w);
        }
    });
    ui.horizontal(|ui| {
        let edit = egui::TextEdit::singleline(&mut w.teacher.new_name)
            .hint_text("New name")
            .char_limit(profiles::LONGEST_NAME)
            .desired_width(ui.available_width() - 68.0);
        ui.add(edit);
        let can = !w.teacher.new_name.trim().is_empty();
        if ui.add_enabled(can, Button::new("Add")).clicked() {
            let name = std::mem::take(&mut w.teacher.new_name);
            match profiles::store().and_then(|mut s| s.add(&name)) {
                Ok(name) => w.settings.profile = name,
                Err(error) => w.notify(format!("{error:#}")),
            }
            list(w);
        }
    });
}

fn list(w: &mut Window) {
    w.teacher.has_listed = true;
    match profiles::store().and_then(|mut s| s.list()) {
        Ok(list) => w.teacher.names = list.into_iter().map(|p| p.name).collect(),
        Err(error) => w.notify(format!("{error:#}")),
    }
    if !w.teacher.names.contains(&w.settings.profile) {
        w.settings.profile.clear();
    }
}

fn open_history(w: &mut Window) {
    let name = w.settings.profile.clone();
    match profiles::store().and_then(|mut s| s.sessions(&name)) {
        Ok(entries) => {
            w.teacher.history = Some(History {
                name,
                entries,
                is_deleting: false,
            });
        }
        Err(error) => w.notify(format!("{error:#}")),
    }
}

/// What is clicked in a history.
enum Click {
    Close,
    Open(String),
    Export(&'static str),
    AskDelete,
    Delete,
}

/// A profile's sessions and the learning curve over them.
pub fn history(w: &mut Window, ctx: &Context) {
    let Some(history) = &w.teacher.history else {
        return;
    };
    let mut click = None;
    let modal = sheet("history").show(ctx, |ui| {
        ui.set_width(620.0);
        ui.heading(format!("History of {}", history.name));
        curve(ui, &history.entries);
        sessions(ui, &history.entries, &mut click);
        ui.add_space(6.0);
        ui.horizontal(|ui| {
            for (text, ending) in [("Export JSON", "json"), ("Export CSV", "csv")] {
                if ui.button(text).clicked() {
                    click = Some(Click::Export(ending));
                }
            }
            let (text, next) = if history.is_deleting {
                ("Really delete all of it", Click::Delete)
            } else {
                ("Delete this profile", Click::AskDelete)
            };
            if ui.button(RichText::new(text).color(style::BAD)).clicked() {
                click = Some(next);
            }
            if ui.button("Close").clicked() {
                click = Some(Click::Close);
            }
        });
    });
    if modal.should_close() {
        click = Some(Click::Close);
    }
    if let Some(click) = click {
        clicked(w, click);
    }
}

fn curve(ui: &mut Ui, entries: &[Entry]) {
    let scores = entries.iter().enumerate();
    let points: Vec<[f64; 2]> = scores
        .filter_map(|(k, e)| Some([k as f64 + 1.0, e.figures.score()?]))
        .collect();
    ui.label(RichText::new("Score over the sessions [%]").color(style::WEAK));
    Plot::new("learning curve")
        .height(130.0)
        .include_y(0.0)
        .include_y(100.0)
        .include_x(1.0)
        .include_x(entries.len().max(2) as f64)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .show(ui, |plot| {
            let dots = egui_plot::Points::new("Score", PlotPoints::from(points.clone()));
            plot.line(Line::new("Score", PlotPoints::from(points)).color(style::ACCENT));
            plot.points(dots.radius(3.0).color(style::GOOD));
        });
}

fn sessions(ui: &mut Ui, entries: &[Entry], click: &mut Option<Click>) {
    if entries.is_empty() {
        ui.label(RichText::new("No session yet").color(style::WEAK));
    }
    ScrollArea::vertical().max_height(170.0).show(ui, |ui| {
        for entry in entries.iter().rev() {
            ui.horizontal(|ui| {
                let score = entry.figures.score();
                let score = score.map_or_else(|| "-".to_owned(), |s| format!("{s:.0} %"));
                ui.label(RichText::new(format!("{} UTC", entry.ended)).monospace());
                ui.label(RichText::new(score).strong());
                ui.label(&entry.scenario);
                if ui.small_button("Look back").clicked() {
                    *click = Some(Click::Open(entry.folder.clone()));
                }
            });
        }
    });
}

fn clicked(w: &mut Window, click: Click) {
    let Some(history) = &mut w.teacher.history else {
        return;
    };
    let name = history.name.clone();
    match click {
        Click::AskDelete => history.is_deleting = true,
        Click::Close => w.teacher.history = None,
        Click::Open(folder) => {
            let path = w.settings.sessions.join(folder).join("session.mcap");
            w.teacher.history = None;
            w.look_back(&path);
        }
        Click::Export(ending) => {
            let path = w
                .settings
                .sessions
                .join(format!("{}.{ending}", slug(&name)));
            let told = profiles::store().and_then(|mut s| profiles::export(&mut s, &name, &path));
            w.notify(match told {
                Ok(_) => format!("The history is in {}", path.display()),
                Err(error) => format!("{error:#}"),
            });
        }
        Click::Delete => {
            let told = profiles::store().and_then(|mut s| s.delete(&name));
            w.teacher.history = None;
            w.notify(match told {
                Ok(()) => format!("{name} is deleted; session folders are left where they are"),
                Err(error) => format!("{error:#}"),
            });
            list(w);
        }
    }
}

/// A name that every file system takes.
fn slug(name: &str) -> String {
    let keep = |c: char| if c.is_alphanumeric() { c } else { '-' };
    format!("history-{}", name.chars().map(keep).collect::<String>())
}

/// Closes what of this lies over the window; says whether anything did.
pub fn dismiss(w: &mut Window) -> bool {
    w.teacher.history.take().is_some()
}

/// Turns the view for a session that is looked at, where none has been chosen.
pub fn first_view(w: &mut Window) {
    if w.view.orbit.is_none() {
        w.see(View::Close);
    }
    panels::forget_summary(w);
}
