//! The command line wins over the scene file.

use super::Scene;
use crate::args::{BakeArgs, BodyArgs, ImportArgs};

impl Scene {
    /// Puts what the command line gives in place of what the scene says.
    pub fn override_with(&mut self, args: &BakeArgs) {
        self.override_import(&args.import);
        self.override_body(&args.body);
        let m = &mut self.motion;
        set(&mut m.fps, args.fps);
        set(&mut m.speed, args.speed);
        set(&mut m.preroll, args.preroll);
        m.clip = args.clip.clone().or(m.clip.take());
        m.frames = args.frames.or(m.frames);
        m.sag &= !args.no_sag;
        let s = &mut self.simulation;
        set(&mut s.method, args.method);
        set(&mut s.scheme, args.scheme);
        set(&mut s.too_long, args.too_long);
        set(&mut s.modes, args.modes);
        s.step = args.step.or(s.step);
        set(&mut s.dynamics, args.dynamics);
        set(&mut s.solver, args.solver);
        set(&mut s.tolerance, args.tolerance);
        set(&mut s.precision, args.precision);
        set(&mut self.material.preset, args.preset);
        self.coupling.two_way |= args.two_way;
        set(&mut self.coupling.root, args.root);
        set(&mut self.coupling.drive, args.drive);
    }

    /// As [`Self::override_with`], for how the file is read.
    pub fn override_import(&mut self, args: &ImportArgs) {
        // height and unit exclude each other: giving one takes the other back
        if args.height.is_some() || args.unit.is_some() {
            (self.import.height, self.import.unit) = (args.height, args.unit);
        }
        self.import.up = args.up.or(self.import.up);
    }

    /// As [`Self::override_with`], for the cells.
    pub fn override_body(&mut self, args: &BodyArgs) {
        if args.cells.is_some() || args.spacing.is_some() {
            (self.body.cells, self.body.spacing) = (args.cells, args.spacing);
        }
        set(&mut self.body.kind, args.kind);
    }
}

fn set<T>(field: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *field = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_height_on_the_command_line_takes_back_the_scenes_unit() {
        let mut scene = Scene { character: "a".into(), ..Scene::default() };
        scene.import.unit = Some(0.01);
        scene.override_import(&ImportArgs { height: Some(1.7), ..ImportArgs::default() });
        assert_eq!((scene.import.height, scene.import.unit), (Some(1.7), None));
    }
}
