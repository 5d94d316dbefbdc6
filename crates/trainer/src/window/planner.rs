//! The osteotomy planner in the window: the line over the scene, points that can be dragged, figures beside it.
//!
//! What it does to a line is in [`crate::planning`]; here is only how it looks and what the mouse means.
use super::app::Window;
use super::conductor::{Phase, Ready};
use super::style;
use crate::planning::{Planning, seen, sight};
use eframe::egui::{
    self, Align2, Button, Color32, Context, DragValue, FontId, Painter, PointerButton, Pos2, Rect,
    Response, RichText, Shape, Slider, Stroke, Ui, pos2, vec2,
};
use osteotome_anatomy::osteotomy::Plan;
use osteotome_anatomy::osteotomy::plan::DEPTHS;
use osteotome_anatomy::{PartKind, Technique};
use osteotome_mechanics::geometry::Vec3;
use osteotome_render::Camera;
use std::path::Path;
use std::sync::Arc;

/// A press this near to a point takes hold of it \[points\].
const GRIP: f32 = 10.0;
const CANAL: Color32 = Color32::from_rgb(242, 158, 26);

/// What a click in the scene means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Mode {
    /// Takes hold of points.
    #[default]
    Drag,
    /// Gives a point of a new line.
    Line,
    /// Gives a point of the canal.
    Canal,
}

/// The planner's state.
#[derive(Default)]
pub struct Planner {
    is_open: bool,
    mode: Mode,
    of: Option<(Arc<Ready>, Planning)>,
    chosen: usize,
    /// The plan as it was when a point was taken hold of.
    held: Option<Plan>,
    /// Places of a line or canal in the making.
    knots: Vec<Vec3>,
    path: String,
    said: Option<(String, bool)>,
}

impl Planner {
    /// On the patient that is ready; a new one begins anew.
    fn attend(&mut self, ready: &Arc<Ready>) {
        let is_same = |of: &(Arc<Ready>, Planning)| Arc::ptr_eq(&of.0, ready);
        if !self.of.as_ref().is_some_and(is_same) {
            let planning = Planning::new(&ready.prepared, &ready.scenario);
            self.of = Some((ready.clone(), planning));
            self.held = None;
            self.knots.clear();
            self.chosen = 0;
        }
    }

    fn told(&mut self, result: Result<String, String>) {
        self.said = Some(match result {
            Ok(text) => (text, true),
            Err(text) => (text, false),
        });
    }
}

/// Whether there is something to plan now, and the planner is wanted.
fn is_shown(w: &Window) -> bool {
    w.planner.is_open && w.conductor.phase() == Phase::Ready
}

/// Opens and closes it.
pub fn switch(w: &mut Window, ui: &mut Ui) {
    let can = w.conductor.phase() == Phase::Ready;
    let wide = vec2(ui.available_width(), 24.0);
    let button = Button::new("Plan the line").selected(w.planner.is_open);
    let button = ui.add_enabled_ui(can, |ui| ui.add_sized(wide, button));
    if button.inner.clicked() {
        w.planner.is_open ^= true;
    }
}

/// The line and the canal over the scene.
pub fn overlay(w: &mut Window, painter: &Painter, rect: Rect) {
    let (true, Some(ready), Some(camera)) =
        (is_shown(w), w.conductor.ready().cloned(), w.view.camera)
    else {
        return;
    };
    w.planner.attend(&ready);
    let planner = &w.planner;
    let Some((_, planning)) = &planner.of else {
        return;
    };
    let place = |p: &Vec3| on_screen(&camera, rect, p);
    if let Some(canal) = planning.canal() {
        let line: Vec<Pos2> = canal.line.iter().filter_map(place).collect();
        let stroke = Stroke::new(2.0, CANAL);
        match canal.is_constructed {
            true => painter.extend(Shape::dashed_line(&line, stroke, 7.0, 5.0)),
            false => painter.extend([Shape::line(line.clone(), stroke)]),
        }
        if let Some(at) = line.last() {
            let text = match canal.is_constructed {
                true => "Canal: constructed, not measured",
                false => "Canal",
            };
            let font = FontId::proportional(12.0);
            painter.text(*at + vec2(8.0, 0.0), Align2::LEFT_CENTER, text, font, CANAL);
        }
    }
    slit(planner, planning, painter, &place);
    let knots: Vec<Pos2> = planner.knots.iter().filter_map(place).collect();
    let color = if planner.mode == Mode::Canal {
        CANAL
    } else {
        Color32::WHITE
    };
    painter.extend([Shape::line(knots.clone(), Stroke::new(1.5, color))]);
    for at in knots {
        painter.circle_filled(at, 3.5, color);
    }
}

fn slit(
    planner: &Planner,
    planning: &Planning,
    painter: &Painter,
    place: &dyn Fn(&Vec3) -> Option<Pos2>,
) {
    let plan = planning.plan();
    let mut last: Option<(Pos2, &PartKind)> = None;
    for (i, p) in plan.points.iter().enumerate() {
        let tip = p.point.at + p.point.toward * p.point.depth;
        let (Some(at), Some(tip)) = (place(&p.point.at), place(&tip)) else {
            last = None;
            continue;
        };
        let figures = planning.review().points.get(i);
        let leaves = figures.is_some_and(|f| f.depth > f.thickness);
        let cuts = figures.and_then(|f| f.canal).is_some_and(|d| d < 0.0);
        let color = if leaves || cuts {
            style::BAD
        } else {
            of_part(&p.part)
        };
        painter.line_segment([at, tip], Stroke::new(1.0, color.gamma_multiply(0.6)));
        if let Some((before, part)) = last {
            let same = *part == p.part;
            let faint = color.gamma_multiply(if same { 1.0 } else { 0.4 });
            painter.line_segment([before, at], Stroke::new(2.0, faint));
        }
        let is_chosen = planner.chosen == i;
        painter.circle_filled(at, if is_chosen { 5.0 } else { 3.0 }, color);
        if is_chosen {
            painter.circle_stroke(at, 7.0, Stroke::new(1.5, Color32::WHITE));
        }
        last = Some((at, &p.part));
    }
}

fn of_part(part: &PartKind) -> Color32 {
    match part {
        PartKind::Medial => Color32::from_rgb(96, 208, 220),
        PartKind::Ridge => Color32::from_rgb(240, 226, 110),
        PartKind::Buccal => Color32::from_rgb(150, 226, 140),
        PartKind::Other(_) => Color32::from_rgb(222, 170, 240),
    }
}

fn on_screen(camera: &Camera, rect: Rect, p: &Vec3) -> Option<Pos2> {
    let [x, y] = seen(camera, p)?;
    let half = 0.5 * rect.height();
    Some(rect.center() + vec2(x as f32 * half, -y as f32 * half))
}

fn ray(camera: &Camera, rect: Rect, at: Pos2) -> [Vec3; 2] {
    let half = 0.5 * rect.height();
    let d = (at - rect.center()) / half;
    sight(camera, [f64::from(d.x), -f64::from(d.y)])
}

/// Takes the mouse where it means the line; says whether it did.
pub fn mouse(w: &mut Window, ui: &Ui, response: &Response, rect: Rect) -> bool {
    let (true, Some(camera)) = (is_shown(w), w.view.camera) else {
        return false;
    };
    let planner = &mut w.planner;
    let Some((_, planning)) = &mut planner.of else {
        return false;
    };
    let pointer = response.interact_pointer_pos();
    if let (true, Some(at)) = (response.clicked(), pointer) {
        let ray = ray(&camera, rect, at);
        let met = match planner.mode {
            Mode::Drag => None,
            Mode::Line => planning.on_bone(ray),
            Mode::Canal => planning.in_bone(ray),
        };
        planner.knots.extend(met);
    }
    if planner.mode != Mode::Drag {
        return false;
    }
    let pressed = response.drag_started_by(PointerButton::Primary) || response.clicked();
    let origin = ui.input(|i| i.pointer.press_origin()).or(pointer);
    if let (true, Some(origin)) = (pressed, origin) {
        let near = planning
            .plan()
            .points
            .iter()
            .enumerate()
            .filter_map(|(i, p)| {
                let off = on_screen(&camera, rect, &p.point.at)?.distance(origin);
                (off < GRIP).then_some((i, off))
            });
        if let Some((i, _)) = near.min_by(|a, b| a.1.total_cmp(&b.1)) {
            planner.chosen = i;
            planner.held = (!response.clicked()).then(|| planning.plan().clone());
        }
    }
    if !response.dragged_by(PointerButton::Primary) {
        planner.held = None;
    }
    if let (Some(from), Some(at)) = (&planner.held, pointer) {
        planning.drag(from, planner.chosen, ray(&camera, rect, at));
        return true;
    }
    false
}

/// Techniques, depth, figures, what is wrong, and saving.
pub fn panel(w: &mut Window, ctx: &Context) {
    if !is_shown(w) {
        return;
    }
    let Some(ready) = w.conductor.ready().cloned() else {
        return;
    };
    w.planner.attend(&ready);
    let mut saved = None;
    egui::Window::new("Osteotomy planner")
        .default_pos(pos2(250.0, 60.0))
        .default_width(250.0)
        .resizable(false)
        .show(ctx, |ui| {
            let planner = &mut w.planner;
            lines(planner, ui);
            modes(planner, ui);
            point(planner, ui);
            findings(planner, ui);
            saved = save(planner, &ready, ui);
            if let Some((text, is_good)) = &planner.said {
                let color = if *is_good { style::GOOD } else { style::BAD };
                ui.label(RichText::new(text).color(color));
            }
        });
    if let Some(path) = saved {
        w.select(&path.to_string_lossy());
    }
}

const TECHNIQUES: [(Technique, &str); 3] = [
    (Technique::Obwegeser, "Obwegeser"),
    (Technique::DalPont, "Dal Pont"),
    (Technique::Hunsuck, "Hunsuck"),
];

fn lines(planner: &mut Planner, ui: &mut Ui) {
    let Some((ready, planning)) = &mut planner.of else {
        return;
    };
    let mut said = None;
    ui.horizontal(|ui| {
        for (technique, name) in TECHNIQUES {
            let button = ui.add_enabled(planning.has_landmarks(), Button::new(name));
            if button.clicked() {
                said = Some(match planning.by_technique(technique) {
                    Ok(()) => Ok(format!("{name}'s line, on landmarks")),
                    Err(error) => Err(format!("{error:#}")),
                });
            }
        }
    });
    ui.horizontal(|ui| {
        if ui.button("Mirror to the other side").clicked() {
            let farthest = planning.mirror();
            said = Some(Ok(format!(
                "Mirrored; at most {farthest:.1} mm off the bone there, snapped to it"
            )));
        }
        if ui.button("Start over").clicked() {
            *planning = Planning::new(&ready.prepared, &ready.scenario);
            said = Some(Ok("The patient's own line".to_owned()));
        }
    });
    let mut kerf = planning.plan().kerf;
    ui.horizontal(|ui| {
        ui.label("Kerf");
        let value = DragValue::new(&mut kerf).range(0.1..=5.0).speed(0.02);
        if ui.add(value.suffix(" mm")).changed() {
            planning.set_kerf(kerf);
        }
    });
    if let Some(said) = said {
        planner.chosen = 0;
        planner.told(said);
    }
}

fn modes(planner: &mut Planner, ui: &mut Ui) {
    let before = planner.mode;
    ui.horizontal(|ui| {
        for (mode, name) in [
            (Mode::Drag, "Drag points"),
            (Mode::Line, "New line"),
            (Mode::Canal, "Draw canal"),
        ] {
            ui.selectable_value(&mut planner.mode, mode, name);
        }
    });
    if planner.mode != before {
        planner.knots.clear();
    }
    let (hint, done) = match planner.mode {
        Mode::Drag => return,
        Mode::Line => (
            "Click the line's points on the bone, in order.",
            "Use the line",
        ),
        Mode::Canal => (
            "Click from the mandibular to the mental foramen; each point lies in the middle of the bone along your sight.",
            "Use the canal",
        ),
    };
    ui.label(RichText::new(hint).small().color(style::WEAK));
    let can = planner.knots.len() >= 2;
    let mut result = None;
    ui.horizontal(|ui| {
        if ui.add_enabled(can, Button::new(done)).clicked()
            && let Some((_, planning)) = &mut planner.of
        {
            let knots = &planner.knots;
            result = Some(match planner.mode {
                Mode::Canal => planning.draw_canal(knots).map_err(|e| format!("{e:#}")),
                _ => planning.by_points(knots).map_err(|e| e.to_string()),
            });
        }
        if ui.button("Clear").clicked() {
            planner.knots.clear();
        }
    });
    if let Some(result) = result {
        if result.is_ok() {
            planner.knots.clear();
            planner.mode = Mode::Drag;
            planner.chosen = 0;
        }
        planner.told(result.map(|()| "Done".to_owned()));
    }
}

fn point(planner: &mut Planner, ui: &mut Ui) {
    let Some((_, planning)) = &mut planner.of else {
        return;
    };
    let i = planner.chosen;
    let Some(point) = planning.plan().points.get(i) else {
        return;
    };
    ui.separator();
    let title = format!("Point {i}, {}", point.part.name());
    ui.label(RichText::new(title).strong().color(of_part(&point.part)));
    let mut depth = point.point.depth;
    ui.horizontal(|ui| {
        ui.label("Depth");
        let slider = Slider::new(&mut depth, DEPTHS[0]..=12.0).suffix(" mm");
        if ui.add(slider.fixed_decimals(1)).changed() {
            planning.set_depth(i, depth);
        }
    });
    let review = planning.review();
    if let Some(figures) = review.points.get(i) {
        ui.label(format!("Bone there: {:.1} mm", figures.thickness));
        if let Some(canal) = figures.canal {
            ui.label(format!("Canal's wall: {canal:.1} mm"));
        }
    }
    let of = match review.canal_is_constructed {
        Some(true) => " (constructed canal)",
        _ => "",
    };
    match review.canal() {
        Some(nearest) => ui.label(format!("Nearest to the canal: {nearest:.1} mm{of}")),
        None => ui.label("No canal is known on this side"),
    };
}

fn findings(planner: &Planner, ui: &mut Ui) {
    let Some((_, planning)) = &planner.of else {
        return;
    };
    ui.separator();
    let review = planning.review();
    if review.faults.is_empty() {
        ui.label(RichText::new("The line is sound").color(style::GOOD));
    }
    for (texts, color) in [(&review.faults, style::BAD), (&review.remarks, style::FAIR)] {
        for text in texts.iter().take(4) {
            ui.label(RichText::new(text).small().color(color));
        }
    }
}

fn save(planner: &mut Planner, ready: &Arc<Ready>, ui: &mut Ui) -> Option<std::path::PathBuf> {
    ui.separator();
    let mut saved = None;
    ui.horizontal(|ui| {
        let edit = egui::TextEdit::singleline(&mut planner.path)
            .hint_text("planned.toml")
            .desired_width(150.0);
        ui.add(edit);
        if ui.button("Save scenario").clicked()
            && let Some((_, planning)) = &planner.of
        {
            let name = match planner.path.trim() {
                "" => "planned.toml",
                name => name,
            };
            let result = planning.save(&ready.scenario, Path::new(name));
            saved = result.as_ref().ok().cloned();
            let told = match result {
                Ok(path) => Ok(format!("Saved: {}", path.display())),
                Err(error) => Err(format!("{error:#}")),
            };
            planner.told(told);
        }
    });
    saved
}
