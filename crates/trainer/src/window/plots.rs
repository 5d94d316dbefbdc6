//! Plots of loads and loop rates, and the force gauges.
use super::live::Live;
use super::style;
use eframe::egui::{
    self, Align2, Color32, CornerRadius, FontId, Pos2, Rect, Sense, Stroke, Ui, vec2,
};
use egui_plot::{GridMark, HLine, Line, Plot, PlotPoints};

/// Seconds that the load plots show.
const WINDOW: f64 = 12.0;
/// Seconds between the lines of the time axis.
const TICK: f64 = 4.0;
/// Colours of the loops.
const LOOPS: [(&str, Color32); 3] = [
    ("Haptic", Color32::from_rgb(94, 196, 230)),
    ("Main", Color32::from_rgb(238, 170, 84)),
    ("Propagation", Color32::from_rgb(206, 132, 220)),
];

/// From a plot to the next \[points\].
const BETWEEN: f32 = 16.0;

/// Three plots side by side, as wide as there is room.
pub fn row(ui: &mut Ui, live: &Live) {
    let size = vec2(
        (ui.available_width() - 2.0 * BETWEEN) / 3.0,
        ui.available_height(),
    );
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = BETWEEN;
        for k in 0..3 {
            ui.allocate_ui_with_layout(size, egui::Layout::top_down(egui::Align::Min), |ui| {
                ui.set_min_size(size);
                ui.spacing_mut().item_spacing.x = 8.0;
                match k {
                    0 => loads(ui, live, "Force on the bone [N]", 0, 20.0),
                    1 => loads(ui, live, "Torque on the bone [N mm]", 1, 500.0),
                    _ => rates(ui, live),
                }
            });
        }
    });
}

/// Narrower than this \[points\] a title is shortened.
const NARROW: f32 = 240.0;

fn title(ui: &mut Ui, text: &str, legend: &[(String, Color32)]) {
    ui.horizontal(|ui| {
        // A narrow plot's title leaves the legend its room.
        let is_narrow = ui.available_width() < NARROW;
        let text = if is_narrow {
            text.replace(" on the bone", "")
        } else {
            text.to_owned()
        };
        ui.label(egui::RichText::new(text).color(style::TEXT).strong());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            for (name, color) in legend.iter().rev() {
                ui.label(egui::RichText::new(name).small().color(*color));
            }
        });
    });
}

fn plot<'a>(id: &str) -> Plot<'a> {
    Plot::new(id)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .show_crosshair(false)
        .show_x(false)
        .show_y(false)
        .y_axis_min_width(38.0)
        .grid_color(style::LINE)
        .x_grid_spacer(|input| {
            let first = (input.bounds.0 / TICK).ceil() as i64;
            let last = (input.bounds.1 / TICK).floor() as i64;
            let mark = |k: i64| GridMark {
                value: TICK * k as f64,
                step_size: TICK,
            };
            (first..=last).map(mark).collect()
        })
        .x_axis_formatter(|mark: GridMark, _| format!("{:.0} s", mark.value))
}

fn loads(ui: &mut Ui, live: &Live, text: &str, what: usize, least: f64) {
    let names = ["Left", "Right"];
    let legend: Vec<_> = (0..2)
        .map(|i| (names[i].to_owned(), style::of_hand(i)))
        .collect();
    title(ui, text, &legend);
    let end = live.time.max(WINDOW);
    let lines: Vec<Line> = (0..2)
        .map(|i| {
            let seen = live.traces.iter().filter(|t| t.0 >= end - WINDOW);
            let points: Vec<[f64; 2]> = seen.map(|t| [t.0, t.1[i][what]]).collect();
            Line::new(names[i], PlotPoints::from(points))
                .color(style::of_hand(i))
                .width(1.6)
        })
        .collect();
    let break_at = live.severed_at;
    plot(text)
        .include_x(end - WINDOW)
        .include_x(end)
        .include_y(0.0)
        .include_y(least)
        .show(ui, |plot| {
            lines.into_iter().for_each(|line| plot.line(line));
            if let Some(time) = break_at.filter(|t| *t >= end - WINDOW) {
                plot.add(
                    egui_plot::VLine::new("Split", time)
                        .color(style::BAD)
                        .width(1.0),
                );
            }
        });
}

/// Steps a second of the clock on a logarithmic axis.
fn rates(ui: &mut Ui, live: &Live) {
    let legend: Vec<_> = (0..3)
        .map(|i| {
            let hz = live.rates[i].back().map_or(0.0, |r| r[1]);
            (format!("{} {hz:.0}", LOOPS[i].0), LOOPS[i].1)
        })
        .collect();
    title(ui, "Loops [Hz]", &legend);
    let end = live.time.max(WINDOW);
    let lines: Vec<Line> = (0..3)
        .map(|i| {
            let seen = live.rates[i]
                .iter()
                .filter(|r| r[0] >= end - WINDOW && r[1] > 0.0);
            let points: Vec<[f64; 2]> = seen.map(|r| [r[0], r[1].log10()]).collect();
            Line::new(LOOPS[i].0, PlotPoints::from(points))
                .color(LOOPS[i].1)
                .width(1.6)
        })
        .collect();
    plot("rates")
        .include_x(end - WINDOW)
        .include_x(end)
        .include_y(0.0)
        .include_y(3.3)
        .y_grid_spacer(|_| {
            let mark = |k: u8| GridMark {
                value: f64::from(k),
                step_size: 1.0,
            };
            (0..=3).map(mark).collect()
        })
        .y_axis_formatter(|mark: GridMark, _| format!("{:.0}", 10f64.powf(mark.value)))
        .show(ui, |plot| {
            for goal in [50f64, 1000.0] {
                let line = HLine::new("Goal", goal.log10())
                    .color(style::LINE)
                    .width(1.0);
                plot.add(line);
            }
            lines.into_iter().for_each(|line| plot.line(line));
        });
}

/// A load against what the device can show: green, yellow, red.
pub fn gauge(ui: &mut Ui, name: &str, text: &str, share: f64) {
    let color = style::of_share(share.clamp(0.0, 1.0));
    marked(ui, name, text, share, color, &[0.5, 0.8]);
}

/// A load as a bar in a colour of its own, with a mark at its target.
pub fn bar(ui: &mut Ui, name: &str, text: &str, share: f64, color: Color32, target: f64) {
    marked(
        ui,
        name,
        text,
        share,
        color,
        &[target.clamp(0.0, 1.0) as f32],
    );
}

fn marked(ui: &mut Ui, name: &str, text: &str, share: f64, color: Color32, marks: &[f32]) {
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 30.0), Sense::hover());
    let painter = ui.painter();
    let font = FontId::proportional(12.0);
    let line = Rect::from_min_size(rect.min, vec2(rect.width(), 15.0));
    painter.text(
        line.left_center(),
        Align2::LEFT_CENTER,
        name,
        font.clone(),
        style::WEAK,
    );
    painter.text(
        line.right_center(),
        Align2::RIGHT_CENTER,
        text,
        font,
        style::TEXT,
    );
    let bar = Rect::from_min_max(Pos2::new(rect.left(), rect.top() + 18.0), rect.max);
    let round = CornerRadius::same(4);
    painter.rect_filled(bar, round, style::WELL);
    let share = share.clamp(0.0, 1.0);
    if share > 0.004 {
        let mut full = bar;
        full.set_width(bar.width() * share as f32);
        painter.rect_filled(full, round, color);
    }
    for part in marks {
        let x = bar.left() + part * bar.width();
        painter.vline(x, bar.y_range(), Stroke::new(1.0, style::PANEL));
    }
    response.widget_info(|| {
        egui::WidgetInfo::labeled(
            egui::Role::ProgressIndicator,
            true,
            format!("{name} {text}"),
        )
    });
}
