//! Bodies without bones under constraints that come, go and move while time passes.

mod engine;

pub use engine::Implicit;

use crate::awake;
use crate::clustered::Clustered;
use crate::constraint::{Constraint, ConstraintError, ConstraintId, Constraints, Progress, SurfaceId};
use crate::elastic::ElasticLaw;
use crate::element::ElementWise;
use crate::mass_point::MassPoints;
use crate::part;
use crate::scheme::Scheme;
use crate::stepper::{ForceLaw, Stepper, StepperError, TooLong};
use engine::{Engine, Local};
use softrig::integrate::State;
use softrig::simulation::{Key, along};

/// What the bodies are made of.
pub enum Law {
    /// Masses with distance, area and volume energies.
    MassPoints(MassPoints<f64>),
    /// Elastic, cell by cell.
    Cells(ElasticLaw<f64, ElementWise<f64>>),
    /// Linear elastic, by block rows.
    Rows(ElasticLaw<f64, Clustered<f64>>),
}

impl ForceLaw<f64> for Law {
    fn force(&mut self, position: &[[f64; 3]], velocity: &[[f64; 3]], force: &mut [[f64; 3]]) {
        match self {
            Self::MassPoints(law) => law.force(position, velocity, force),
            Self::Cells(law) => law.force(position, velocity, force),
            Self::Rows(law) => law.force(position, velocity, force),
        }
    }
}

/// A constraint with its times.
#[derive(Clone, Debug, PartialEq)]
pub struct Timed {
    /// What it asks.
    pub constraint: Constraint,
    /// The first step it acts in begins at or after this [s].
    pub start: f64,
    /// It acts in no step that begins at or after this [s]; infinite for good.
    pub end: f64,
    /// Time over which the gap that it finds closes [s] ([`Constraints::approach`]).
    pub ramp: f64,
    /// How far a nail is from where it is at rest, over time; empty: not at all.
    pub path: Vec<Key>,
}

struct Entry {
    timed: Timed,
    id: ConstraintId,
    /// Place of a nail that has not moved [m].
    goal: Option<[f64; 3]>,
}

/// How bodies are stepped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectSettings {
    /// How a step is taken.
    pub scheme: Scheme,
    /// What happens to steps beyond the stability limit.
    pub too_long: TooLong,
    /// Longest step [s].
    pub longest_step: f64,
    /// Part of the forces that is the same drag on everything [1/s].
    pub drag: f64,
}

/// Bodies, their constraints, and where they are.
pub struct Objects {
    /// Motion of the nodes.
    pub state: State<f64>,
    engine: Engine,
    set: Constraints,
    entries: Vec<Entry>,
    settings: ObjectSettings,
    /// When the next constraint is switched [s].
    next_switch: f64,
}

/// Rounding of times that are sums of steps [s].
const HAIR: f64 = 1e-9;

impl Objects {
    /// Bodies at rest at these places [m], with these masses [kg].
    ///
    /// # Errors
    /// [`StepperError`] as of [`Stepper::new`].
    pub fn new(
        rest: Vec<[f64; 3]>,
        mass: &[f64],
        mut law: Law,
        settings: ObjectSettings,
    ) -> Result<Self, StepperError> {
        let mut stepper = Stepper::new(settings.scheme, mass, &rest, &mut law, settings.drag)?;
        stepper.too_long = settings.too_long;
        let set = Constraints::new(rest.len());
        let state = State::at_rest(rest);
        let engine = Engine::Local(Box::new(Local { law, stepper }));
        Ok(Self { state, engine, set, entries: Vec::new(), settings, next_switch: f64::NEG_INFINITY })
    }

    /// Bodies at rest that are stepped implicitly and whose constraints are eliminated; `longest_step` in s.
    #[must_use]
    pub fn implicit(implicit: Implicit, longest_step: f64) -> Self {
        let rest = implicit.body.mesh.nodes.clone();
        let settings =
            ObjectSettings { scheme: Scheme::ImplicitEuler, too_long: TooLong::Substep, longest_step, drag: 0.0 };
        Self {
            set: Constraints::eliminated(rest.len()),
            state: State::at_rest(rest),
            engine: Engine::Implicit(Box::new(implicit)),
            entries: Vec::new(),
            settings,
            next_switch: f64::NEG_INFINITY,
        }
    }

    /// Adds a surface for nodes to slide on.
    ///
    /// # Errors
    /// [`ConstraintError`] for one that is open or names nodes that are not there.
    pub fn add_surface(&mut self, triangles: Vec<[u32; 3]>) -> Result<SurfaceId, ConstraintError> {
        self.set.add_surface(triangles)
    }

    /// Adds a constraint; it is switched on when its time comes.
    ///
    /// # Errors
    /// [`ConstraintError`] when it is no constraint of these bodies.
    pub fn add(&mut self, timed: Timed) -> Result<ConstraintId, ConstraintError> {
        let goal = match &timed.constraint {
            Constraint::Nail { goal, .. } => Some(*goal),
            _ => None,
        };
        let id = self.set.add_inactive(timed.constraint.clone())?;
        if goal.is_none() && !timed.path.is_empty() {
            let kind = timed.constraint.kind();
            self.set.remove(id)?;
            return Err(ConstraintError::NoGoal { kind, id: id.0 });
        }
        self.entries.push(Entry { timed, id, goal });
        self.next_switch = f64::NEG_INFINITY;
        Ok(id)
    }

    /// The constraints: their forces, and which of them act.
    #[must_use]
    pub fn constraints(&self) -> &Constraints {
        &self.set
    }

    /// Longest step that is taken in one piece [s].
    #[must_use]
    pub fn limit(&self) -> f64 {
        self.engine.limit().min(self.settings.longest_step)
    }

    /// Advances to `time` [s] in equal steps; returns how many.
    ///
    /// # Errors
    /// [`StepperError`]; steps before the one that failed are done.
    pub fn advance(&mut self, time: f64) -> Result<usize, StepperError> {
        let dt = time - self.state.time;
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(StepperError::BadStep(dt));
        }
        let (limit, longest) = (self.engine.limit(), self.settings.longest_step.min(dt));
        let scheme = self.engine.scheme(&self.settings);
        let steps = (dt / longest.min(limit) - HAIR).ceil().max(1.0);
        // as many as a frame of a scene may have
        if steps.is_nan() || steps > 1e6 {
            return Err(StepperError::NeverStable { scheme, limit });
        }
        if longest > limit && self.settings.too_long == TooLong::Refuse {
            return Err(StepperError::Unstable {
                scheme,
                dt: longest,
                limit,
                substeps: (longest / limit).ceil() as usize,
            });
        }
        let (begin, h) = (self.state.time, dt / steps);
        let many = self.state.position.len() > part::PART;
        let mut run = || -> Result<(), StepperError> {
            for k in 0..steps as usize {
                self.switch(begin + k as f64 * h, h)?;
                self.engine.step(&mut self.set, &mut self.state, h)?;
            }
            Ok(())
        };
        // small bodies have one part
        if many { awake(run) } else { run() }?;
        self.state.time = time;
        Ok(steps as usize)
    }

    /// Switches constraints on and off, and moves nails to where they are at the end of the step from `now` [s].
    fn switch(&mut self, now: f64, h: f64) -> Result<(), ConstraintError> {
        if now >= self.next_switch - HAIR {
            let acts = |t: &Timed| now >= t.start - HAIR && now < t.end - HAIR;
            // nodes are let go before others take hold of them
            for e in self.entries.iter().filter(|e| !acts(&e.timed)) {
                self.set.set_active(e.id, false)?;
            }
            self.next_switch = f64::INFINITY;
            for e in &self.entries {
                let t = &e.timed;
                if acts(t) && !self.set.is_active(e.id)? {
                    self.set.set_active(e.id, true)?;
                    self.set.approach(e.id, (t.ramp / h).ceil().min(1e9) as u32)?;
                }
                for time in [t.start, t.end] {
                    if time > now + HAIR {
                        self.next_switch = self.next_switch.min(time);
                    }
                }
            }
        }
        for e in self.entries.iter().filter(|e| !e.timed.path.is_empty()) {
            if let (Some(goal), Some((by, rate))) = (e.goal, along(&e.timed.path, now + h)) {
                self.set.set_goal(e.id, std::array::from_fn(|k| goal[k] + by[k]))?;
                self.set.set_rate(e.id, rate)?;
            }
        }
        Ok(())
    }

    /// All that the next step reads besides what the bodies were made from: for [`Self::restore`].
    #[must_use]
    pub fn snapshot(&self) -> Vec<f64> {
        let s = &self.state;
        let mut out = vec![s.time];
        out.extend([&s.position, &s.velocity, &s.acceleration].into_iter().flatten().flatten());
        for e in &self.entries {
            let p = self.set.progress(e.id).unwrap_or_default();
            let gaps = p.gap.as_ref().map_or(-1.0, |g| g.len() as f64);
            out.extend([f64::from(u8::from(p.active)), f64::from(p.steps), f64::from(p.done), gaps]);
            out.extend(p.gap.iter().flatten().flatten());
        }
        out.extend(self.engine.history().iter().flatten());
        out
    }

    /// Puts a snapshot back; `false` when it is of other bodies, and nothing has changed then.
    pub fn restore(&mut self, snapshot: &[f64]) -> bool {
        let n = self.state.position.len();
        let cells = self.engine.history().len();
        let Some((motion, mut rest)) = snapshot.split_at_checked(1 + 9 * n) else { return false };
        let list = |k: usize| motion[1 + 3 * n * k..1 + 3 * n * (k + 1)].as_chunks::<3>().0.to_vec();
        let mut set = self.set.clone();
        // all off first, so that none is in the way of another
        if self.entries.iter().any(|e| set.set_active(e.id, false).is_err()) {
            return false;
        }
        for e in &self.entries {
            let Some(([active, steps, done, gaps], after)) = rest.split_first_chunk() else { return false };
            let Some((gap, after)) = after.split_at_checked((gaps.max(0.0) as usize).saturating_mul(3)) else {
                return false;
            };
            let gap = (*gaps >= 0.0).then(|| gap.as_chunks::<3>().0.to_vec());
            let progress = Progress { active: *active > 0.0, steps: *steps as u32, done: *done as u32, gap };
            if set.set_progress(e.id, &progress).is_err() {
                return false;
            }
            rest = after;
        }
        if rest.len() != 4 * cells {
            return false;
        }
        self.set = set;
        self.state = State { time: motion[0], position: list(0), velocity: list(1), acceleration: list(2) };
        self.engine.restore(rest.as_chunks::<4>().0, &mut self.set, motion[0]);
        self.next_switch = f64::NEG_INFINITY;
        true
    }
}
