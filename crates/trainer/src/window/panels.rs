//! What stands around the scene.
use super::app::{STEREO, Window};
use super::catalogue::{self, Leading};
use super::coach::Hints;
use super::conductor::Phase;
use super::live::look;
use super::mouse_hands::Held;
use super::shortcuts::{self, Command};
use super::{picker, planner, plots, style, teacher};
use crate::picture::{Orbit, View};
use crate::talk;
use eframe::egui::{
    self, Align, Button, Color32, ComboBox, Context, CornerRadius, Frame, Layout, Margin, Panel,
    ProgressBar, RichText, ScrollArea, Ui, vec2,
};
use std::path::Path;

const HANDS: [&str; 2] = ["Left hand", "Right hand"];

pub(super) fn frame(margin: Margin) -> Frame {
    Frame::new().fill(style::PANEL).inner_margin(margin)
}

/// A group under a title.
pub(super) fn card(ui: &mut Ui, title: &str, content: impl FnOnce(&mut Ui)) {
    Frame::new()
        .fill(style::CARD)
        .corner_radius(CornerRadius::same(7))
        .inner_margin(Margin::symmetric(10, 8))
        .show(ui, |ui| {
            ui.set_width(ui.available_width());
            let title = RichText::new(title.to_uppercase()).small().strong();
            ui.label(title.color(style::WEAK));
            content(ui);
        });
}

/// Start, pause, end, reset, try again; state and time.
pub fn bar(w: &mut Window, ui: &mut Ui) {
    let ctx = ui.ctx().clone();
    Panel::top("bar")
        .exact_size(48.0)
        .frame(frame(Margin::symmetric(12, 0)))
        .show(ui, |ui| {
            ui.horizontal_centered(|ui| {
                ui.label(RichText::new("Osteotome").heading().strong());
                ui.add_space(14.0);
                buttons(w, ui, &ctx);
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    state(w, ui, &ctx);
                });
            });
        });
}

fn buttons(w: &mut Window, ui: &mut Ui, ctx: &Context) {
    let phase = w.conductor.phase();
    let (go, can_go) = match phase {
        Phase::Running => ("Pause", true),
        Phase::Paused => ("Go on", true),
        Phase::Ready => ("Start", true),
        Phase::Empty | Phase::Preparing | Phase::Recomputing | Phase::Keeping => ("Start", false),
    };
    let main = Button::new(RichText::new(go).strong().color(Color32::WHITE))
        .fill(style::ACCENT)
        .min_size(vec2(96.0, 30.0));
    if ui
        .add_enabled(can_go, main)
        .on_hover_text("Space")
        .clicked()
    {
        w.obey(ctx, Command::Go);
    }
    let is_live = matches!(phase, Phase::Running | Phase::Paused | Phase::Recomputing);
    let has_run = is_live || look(&w.live).time > 0.0;
    for (text, can, hint, command) in [
        (
            "End",
            is_live,
            "End the session and keep it (F4)",
            Command::Finish,
        ),
        (
            "Reset",
            has_run && phase != Phase::Keeping,
            "Back to the beginning; what ran is kept (F8)",
            Command::Reset,
        ),
        (
            "Try again",
            has_run && phase != Phase::Keeping,
            "Begin anew; what ran is kept (F5)",
            Command::Retry,
        ),
    ] {
        let button = Button::new(text).min_size(vec2(0.0, 30.0));
        if ui.add_enabled(can, button).on_hover_text(hint).clicked() {
            w.obey(ctx, command);
        }
    }
}

fn state(w: &mut Window, ui: &mut Ui, ctx: &Context) {
    let help = Button::new("Keys").min_size(vec2(0.0, 30.0));
    if ui.add(help).on_hover_text("F1").clicked() {
        w.obey(ctx, Command::Help);
    }
    let (time, is_split) = {
        let live = look(&w.live);
        (live.time, live.severed_at.is_some())
    };
    let (word, color) = match w.conductor.phase() {
        Phase::Empty => ("No scenario", style::BAD),
        Phase::Preparing => ("Preparing", style::FAIR),
        Phase::Ready if w.teacher.back.is_some() => ("Looking back", style::ACCENT),
        Phase::Ready if time > 0.0 => ("Ended", style::WEAK),
        Phase::Ready => ("Ready", style::GOOD),
        Phase::Recomputing => ("Recomputing", style::FAIR),
        Phase::Running if is_split => ("Running, split", style::GOOD),
        Phase::Running => ("Running", style::GOOD),
        Phase::Paused => ("Paused", style::FAIR),
        Phase::Keeping => ("Keeping the session", style::FAIR),
    };
    ui.add_space(6.0);
    ui.label(
        RichText::new(format!("{time:6.2} s"))
            .monospace()
            .size(16.0),
    );
    ui.add_space(6.0);
    ui.label(RichText::new(word).color(color).strong());
    let (spot, _) = ui.allocate_exact_size(vec2(10.0, 10.0), egui::Sense::hover());
    ui.painter().circle_filled(spot.center(), 4.0, color);
}

/// Notices, or what the mouse does now.
pub fn foot(w: &mut Window, ui: &mut Ui) {
    Panel::bottom("foot")
        .exact_size(26.0)
        .frame(frame(Margin::symmetric(12, 0)))
        .show(ui, |ui| {
            ui.horizontal_centered(|ui| {
                let drawn = match &w.view.texture {
                    Some(t) => {
                        let [x, y] = t.size();
                        let wished = w.view.orbit.as_ref().map(Orbit::camera);
                        if w.view.camera == wished {
                            format!("Scene {x} x {y}, {:.0} ms", w.view.ms)
                        } else {
                            format!("Scene {x} x {y}, drawing")
                        }
                    }
                    None => "Scene, drawing".into(),
                };
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    ui.label(RichText::new(drawn).small().color(style::WEAK));
                    ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                        let text = match &w.notice {
                            Some((text, _)) => RichText::new(text).color(style::FAIR),
                            None => RichText::new(hint(w)).color(style::WEAK),
                        };
                        ui.add(egui::Label::new(text.size(12.0)).truncate());
                    });
                });
            });
        });
}

fn hint(w: &Window) -> &'static str {
    match w.hands.held {
        Held::None if w.hands.leads_any() => {
            "Drag turns the view, wheel zooms. Keys 1, 2, 3 take hold of the left, the right, both chisels."
        }
        Held::None => "Drag turns the view, middle drag shifts it, wheel zooms. F1 lists the keys.",
        _ => {
            "Drag moves the chisel, wheel drives it, Shift + drag twists, Ctrl + drag pries; right drag turns the view; 0 lets go."
        }
    }
}

/// On one leaf scenario, hands and teaching, on the other the view: each fits a window of 1280 x 720 without scrolling.
pub fn left(w: &mut Window, ui: &mut Ui) {
    Panel::left("left")
        .exact_size(236.0)
        .frame(frame(Margin::symmetric(10, 8)))
        .show(ui, |ui| {
            ScrollArea::vertical().show(ui, |ui| {
                leaves(w, ui);
                if w.view.is_being_set {
                    return card(ui, "View", |ui| view(w, ui));
                }
                card(ui, "Scenario", |ui| scenario(w, ui));
                card(ui, "Hands", |ui| hands(w, ui));
                card(ui, "Who trains", |ui| teacher::profile(w, ui));
                card(ui, "Teaching", |ui| teacher::switches(w, ui));
                card(ui, "Sessions", |ui| sessions(w, ui));
            });
        });
}

fn leaves(w: &mut Window, ui: &mut Ui) {
    let half = (ui.available_width() - ui.spacing().item_spacing.x) / 2.0;
    ui.horizontal(|ui| {
        for (is_view, name) in [(false, "Session"), (true, "View")] {
            let is_on = w.view.is_being_set == is_view;
            let button = Button::new(name).selected(is_on);
            if ui.add(button.min_size(vec2(half, 24.0))).clicked() {
                w.view.is_being_set = is_view;
            }
        }
    });
}

pub(super) fn wide_combo(id: &str, selected: &str, ui: &Ui) -> ComboBox<'static> {
    ComboBox::from_id_salt(id.to_owned())
        .selected_text(selected.to_owned())
        .width(ui.available_width())
        .truncate()
}

fn scenario(w: &mut Window, ui: &mut Ui) {
    let mut picked = None;
    let recent = w.settings.recent.clone();
    wide_combo("scenario", &catalogue::title(&w.scenario), ui).show_ui(ui, |ui| {
        for (name, title, _) in catalogue::SHIPPED {
            if ui.selectable_label(w.scenario == name, title).clicked() {
                picked = Some(name.to_owned());
            }
        }
        for file in &recent {
            let name = file.to_string_lossy();
            let label = ui.selectable_label(w.scenario == name, catalogue::title(&name));
            if label.on_hover_text(&*name).clicked() {
                picked = Some(name.into_owned());
            }
        }
    });
    if let Some(name) = picked {
        w.select(&name);
    }
    ui.horizontal(|ui| {
        let width = ui.available_width() - 72.0;
        let edit = egui::TextEdit::singleline(&mut w.path)
            .hint_text("Path of a file")
            .desired_width(width - 8.0);
        let entered = ui.add(edit).lost_focus() && ui.input(|i| i.key_pressed(egui::Key::Enter));
        let is_empty = w.path.trim().is_empty();
        let name = if is_empty { "Browse" } else { "Open" };
        let wide = vec2(ui.available_width(), 24.0);
        let is_clicked = ui.add(Button::new(name).min_size(wide)).clicked();
        if is_clicked && is_empty {
            picker::open(w);
        } else if is_clicked || entered {
            open_path(w);
        }
    });
    planner::switch(w, ui);
}

/// Goes over to the scenario file whose path has been typed or dropped.
pub fn open_path(w: &mut Window) {
    let path = w.path.trim().to_owned();
    let is_recording = Path::new(&path)
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("mcap"));
    if is_recording && Path::new(&path).is_file() {
        w.look_back(Path::new(&path));
        w.path.clear();
    } else if Path::new(&path).is_file() {
        w.select(&path);
        w.path.clear();
    } else if !path.is_empty() {
        w.notify(format!(
            "{path}: there is no such file; give a scenario (TOML) or a session.mcap"
        ));
    }
}

fn hands(w: &mut Window, ui: &mut Ui) {
    let mut options = vec![Leading::Surgeon, Leading::Mouse];
    options.extend(w.devices.found.iter().cloned().map(Leading::Device));
    for (i, name) in HANDS.into_iter().enumerate() {
        let now = w.leading[i].clone();
        let side = name.split(' ').next().unwrap_or(name);
        ui.horizontal(|ui| {
            let label = RichText::new(side).color(style::of_hand(i));
            ui.add_sized(vec2(40.0, 20.0), egui::Label::new(label));
            wide_combo(name, &now.title(), ui).show_ui(ui, |ui| {
                let others = (!options.contains(&now)).then_some(&now);
                for option in options.iter().chain(others) {
                    let label = ui.selectable_label(now == *option, option.title());
                    if label.clicked() {
                        w.leading[i] = option.clone();
                    }
                }
            });
        });
    }
    let seek = match w.devices.is_seeking() {
        true => "Looking for devices...",
        false => "Look for devices",
    };
    let wide = vec2(ui.available_width(), 24.0);
    let can = !w.devices.is_seeking();
    let button = ui.add_enabled_ui(can, |ui| ui.add_sized(wide, Button::new(seek)));
    if button.inner.clicked() {
        w.devices.seek();
    }
}

const VIEWS: [(View, &str); 6] = [
    (View::Close, "Close"),
    (View::Procedure, "Procedure"),
    (View::Front, "Front"),
    (View::Top, "Top"),
    (View::Left, "Left"),
    (View::Right, "Right"),
];

fn view(w: &mut Window, ui: &mut Ui) {
    let ctx = ui.ctx().clone();
    let half = vec2(
        (ui.available_width() - ui.spacing().item_spacing.x) / 2.0,
        24.0,
    );
    egui::Grid::new("views")
        .num_columns(2)
        .min_col_width(half.x)
        .show(ui, |ui| {
            for (k, (view, name)) in VIEWS.into_iter().enumerate() {
                let is_on = !w.view.is_first_person && w.settings.view == Some(view);
                let button = Button::new(name).selected(is_on).min_size(half);
                if ui.add(button).clicked() {
                    w.obey(&ctx, Command::View(view));
                }
                if k % 2 == 1 {
                    ui.end_row();
                }
            }
        });
    let first = Button::new("First person").selected(w.view.is_first_person);
    let wide = vec2(ui.available_width(), 24.0);
    if ui.add_sized(wide, first).clicked() {
        w.obey(&ctx, Command::FirstPerson);
    }
    ui.checkbox(&mut w.settings.is_transparent, "Look through the bone");
    ui.horizontal(|ui| {
        ui.checkbox(&mut w.settings.shows_loads, "Load arrows");
        ui.checkbox(&mut w.settings.shows_head, "Head");
    });
    ui.horizontal(|ui| {
        ui.label("Apart");
        ui.spacing_mut().slider_width = ui.available_width() - 70.0;
        ui.add(
            egui::Slider::new(&mut w.apart, 0.0..=30.0)
                .suffix(" mm")
                .fixed_decimals(0),
        );
    });
    ui.horizontal(|ui| {
        ui.label("Stereo");
        let now = STEREO.iter().find(|s| s.0 == w.settings.stereo);
        wide_combo("stereo", now.map_or("Off", |s| s.1), ui).show_ui(ui, |ui| {
            for (mode, name) in STEREO {
                ui.selectable_value(&mut w.settings.stereo, mode, name);
            }
        });
    });
}

fn sessions(w: &mut Window, ui: &mut Ui) {
    let shown = w.settings.sessions.display().to_string();
    let label = egui::Label::new(RichText::new(&shown).small().color(style::WEAK)).truncate();
    ui.add(label).on_hover_text(&shown);
    ui.checkbox(&mut w.settings.draws_pictures, "Pictures in the folder");
}

/// State, gauges, events.
pub fn right(w: &mut Window, ui: &mut Ui) {
    Panel::right("right")
        .exact_size(236.0)
        .frame(frame(Margin::symmetric(10, 8)))
        .show(ui, |ui| {
            let hints = teacher::hints(w);
            card(ui, "Crack", |ui| crack(w, ui, hints.as_ref()));
            for (i, name) in HANDS.into_iter().enumerate() {
                card(ui, name, |ui| gauges(w, ui, i, hints.as_ref()));
            }
            card(ui, "Events", |ui| events(w, ui));
        });
}

pub(super) fn row(ui: &mut Ui, name: &str, value: RichText) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(name).color(style::WEAK));
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| ui.label(value));
    });
}

fn crack(w: &Window, ui: &mut Ui, hints: Option<&Hints>) {
    let live = look(&w.live);
    row(
        ui,
        "Broken",
        RichText::new(format!("{:.0} mm²", live.area())).strong(),
    );
    row(
        ui,
        "Fragments",
        RichText::new(live.fragments().to_string()).strong(),
    );
    let split = match live.severed_at {
        Some(time) => RichText::new(format!("complete at {time:.2} s")).color(style::GOOD),
        None => RichText::new("not complete"),
    };
    row(ui, "Split", split.strong());
    if let Some(hints) = hints.filter(|h| h.crack.is_some()) {
        row(ui, "To the canal", teacher::distance(hints.crack.as_ref()));
    }
    if teacher::is_exam(w) {
        ui.label(RichText::new("Exam: no hints").small().color(style::FAIR));
    }
}

fn gauges(w: &Window, ui: &mut Ui, i: usize, hints: Option<&Hints>) {
    let live = look(&w.live);
    let Some(tool) = w.conductor.ready().map(|r| r.scenario.tool[i].clone()) else {
        return;
    };
    let limits = &tool.limits;
    let wrench = live.hands.map(|h| h.hands[i].wrench).unwrap_or_default();
    let shares = [
        wrench.force.norm() / limits.force,
        wrench.torque.norm() / limits.torque,
    ];
    let scales = [
        tool.force_scale / limits.force,
        tool.torque_scale / limits.torque,
    ];
    for (k, (name, unit)) in [("Force", "N"), ("Torque", "N mm")].into_iter().enumerate() {
        match hints.map(|h| &h.loads[i][k]) {
            Some(hint) => teacher::load(ui, name, hint, unit, shares[k], hint.good * scales[k]),
            None => {
                let text = format!("{:.0} {unit}", live.loads[i][k]);
                plots::gauge(ui, name, &text, shares[k]);
            }
        }
    }
    let contacts = live.hands.map_or(0, |h| h.hands[i].contacts);
    let (text, color) = if live.saturated[i] {
        ("device at its limit", style::BAD)
    } else if contacts > 0 {
        ("in contact", style::WEAK)
    } else {
        ("free", style::WEAK)
    };
    let state = RichText::new(text).small().color(color);
    let Some(hints) = hints else {
        ui.label(state);
        return;
    };
    ui.horizontal(|ui| {
        ui.label(state);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.label(teacher::distance(hints.tools[i].as_ref()).small());
            ui.label(RichText::new("to the canal").small().color(style::WEAK));
        });
    });
}

fn events(w: &Window, ui: &mut Ui) {
    let live = look(&w.live);
    ScrollArea::vertical()
        .stick_to_bottom(true)
        .auto_shrink([false, false])
        .show(ui, |ui| {
            if live.events.is_empty() {
                ui.label(RichText::new("Nothing yet").small().color(style::WEAK));
            }
            for (time, event) in &live.events {
                ui.label(RichText::new(format!("{time:.2} s  {event}")).small());
            }
        });
}

/// Loads and loop rates over time.
pub fn plots(w: &mut Window, ui: &mut Ui) {
    Panel::bottom("plots")
        .exact_size(180.0)
        .frame(frame(Margin::symmetric(12, 8)))
        .show(ui, |ui| plots::row(ui, &look(&w.live)));
}

/// Over the whole window.
pub(super) fn sheet(name: &str) -> egui::Modal {
    let frame = Frame::new()
        .fill(style::CARD)
        .stroke(egui::Stroke::new(1.0, style::LINE))
        .corner_radius(CornerRadius::same(10))
        .inner_margin(Margin::same(20));
    egui::Modal::new(egui::Id::unique(name)).frame(frame)
}

/// All keys.
pub fn help(w: &mut Window, ctx: &Context) {
    if !w.shows_help {
        return;
    }
    let modal = sheet("keys").show(ctx, |ui| {
        ui.set_width(700.0);
        ui.heading("Keys and mouse");
        ui.add_space(4.0);
        ui.columns(2, |columns| {
            let (commands, gestures) = shortcuts::COMMANDS.split_at(18);
            keys(&mut columns[0], "Commands", commands);
            keys(&mut columns[1], "Chisels", gestures);
            columns[1].add_space(8.0);
            list(
                &mut columns[1],
                "Mouse, and keys held down",
                &shortcuts::GESTURES,
            );
        });
        ui.add_space(4.0);
        ui.button("Close").clicked()
    });
    if modal.inner || modal.should_close() {
        w.shows_help = false;
    }
}

fn keys(ui: &mut Ui, title: &str, commands: &[(egui::Modifiers, egui::Key, Command, &str)]) {
    let rows: Vec<(String, &str)> = commands
        .iter()
        .filter(|c| !c.3.is_empty())
        .map(|c| (shortcuts::name(c.0, c.1), c.3))
        .collect();
    let rows: Vec<(&str, &str)> = rows.iter().map(|r| (r.0.as_str(), r.1)).collect();
    list(ui, title, &rows);
}

fn list(ui: &mut Ui, title: &str, rows: &[(&str, &str)]) {
    ui.label(RichText::new(title).strong().color(style::WEAK));
    egui::Grid::new(title)
        .num_columns(2)
        .spacing([12.0, 3.0])
        .show(ui, |ui| {
            for (key, meaning) in rows {
                ui.label(RichText::new(*key).monospace().size(11.0));
                ui.label(RichText::new(*meaning).size(12.0));
                ui.end_row();
            }
        });
}

/// How the session went.
pub fn summary(w: &mut Window, ctx: &Context) {
    let Some(kept) = &w.summary else { return };
    let outcome = kept.metrics.outcome();
    let folder = kept.folder.clone();
    let mut command = None;
    let mut looks_back = false;
    let score = kept.score;
    let modal = sheet("summary").show(ctx, |ui| {
        ui.set_width(560.0);
        let (title, color) = match outcome.time {
            Some(_) => ("Split complete", style::GOOD),
            None => ("Session ended", style::FAIR),
        };
        ui.label(RichText::new(title).heading().strong().color(color));
        ui.add_space(4.0);
        for line in talk::summary(&outcome).lines() {
            // Columns are for letters of one width.
            let words: Vec<&str> = line.split_whitespace().collect();
            ui.label(words.join(" ").replace("mm2", "mm²"));
        }
        if let Some(score) = score {
            ui.label(RichText::new(format!("Score: {score:.0} %")).strong());
        }
        ui.add_space(4.0);
        let shown = RichText::new(folder.display().to_string()).small();
        ui.label(shown.color(style::WEAK));
        ui.add_space(6.0);
        ui.horizontal(|ui| {
            if ui.button("Open the folder").clicked() {
                command = Some(None);
            }
            if ui.button("Try again").clicked() {
                command = Some(Some(Command::Retry));
            }
            if ui.button("Look back").clicked() {
                looks_back = true;
            }
            if ui.button("Look at the bone").clicked() {
                command = Some(Some(Command::Dismiss));
            }
        });
    });
    if looks_back {
        w.look_back(&folder.join("session.mcap"));
        return;
    }
    match command {
        Some(Some(command)) => w.obey(ctx, command),
        Some(None) => {
            if let Err(error) = open::that_detached(&folder) {
                w.notify(format!("{} cannot be opened: {error}", folder.display()));
            }
        }
        None if modal.should_close() => w.summary = None,
        None => {}
    }
}

/// Takes away how the last session went.
pub fn forget_summary(w: &mut Window) {
    w.summary = None;
}

/// How far a patient's preparation or the keeping of a session is.
pub fn progress(w: &Window, ui: &mut Ui) {
    let (words, share) = w.conductor.stand();
    let title = match w.conductor.phase() {
        Phase::Preparing => "Preparing the patient",
        Phase::Recomputing => "Going back to the moment",
        Phase::Keeping => "Keeping the session",
        _ => return,
    };
    Frame::new()
        .fill(style::CARD.gamma_multiply(0.92))
        .corner_radius(CornerRadius::same(8))
        .inner_margin(Margin::same(14))
        .show(ui, |ui| {
            ui.set_width(300.0);
            ui.label(RichText::new(title).strong());
            ui.add(
                ProgressBar::new(share)
                    .desired_height(8.0)
                    .fill(style::ACCENT),
            );
            ui.label(RichText::new(words).small().color(style::WEAK));
        });
}
