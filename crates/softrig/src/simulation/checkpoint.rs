//! Everything the next step reads, as bytes: restored in a new process a simulation goes on bit for bit.

use super::{Motion, Simulation};
use crate::integrate::State;
use softrig_linalg::Scalar;

/// A snapshot of a [`Simulation`]. Bones are not in it: they come from the motion at the stored time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint(Vec<u8>);

/// Why a checkpoint does not fit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// Made by another version, precision or body.
    #[error("the checkpoint is not of this simulation ({0}); bake from the start with --force")]
    Mismatch(&'static str),
}

const MAGIC: &[u8; 8] = b"softrig1";

impl Checkpoint {
    /// The bytes, to be stored.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// From stored bytes; checked when restored.
    #[must_use]
    pub fn from_bytes(bytes: Vec<u8>) -> Self {
        Self(bytes)
    }
}

impl<R: Scalar> Simulation<R> {
    /// A snapshot of the current state. The solver forgets what it kept from earlier solves, so that from here on this
    /// simulation and one restored from the snapshot do the same.
    pub fn checkpoint(&mut self) -> Checkpoint {
        self.solver.forget();
        let mut out = MAGIC.to_vec();
        out.extend_from_slice(R::NAME.as_bytes());
        put(&mut out, self.state.time);
        put(&mut out, self.last_move.unwrap_or(f64::NAN));
        for list in [&self.state.position, &self.state.velocity, &self.state.acceleration] {
            out.extend_from_slice(&(list.len() as u64).to_le_bytes());
            list.iter().flatten().for_each(|v| put(&mut out, v.to_f64()));
        }
        let history = self.body.model.history();
        out.extend_from_slice(&(history.len() as u64).to_le_bytes());
        history.iter().flatten().for_each(|v| put(&mut out, v.to_f64()));
        if let Some(c) = &mut self.coupled {
            c.stepper.forget();
            c.now.write(&mut out);
        }
        Checkpoint(out)
    }

    /// Puts a snapshot back. `motion` must be the one the snapshot was made under.
    ///
    /// # Errors
    /// [`CheckpointError`] when it is of another simulation; nothing has changed then.
    pub fn restore(&mut self, checkpoint: &Checkpoint, motion: &dyn Motion) -> Result<(), CheckpointError> {
        let mut bytes = Reader(&checkpoint.0);
        if bytes.take(8)? != MAGIC {
            return Err(CheckpointError::Mismatch("another format"));
        }
        if bytes.take(R::NAME.len())? != R::NAME.as_bytes() {
            return Err(CheckpointError::Mismatch("another precision"));
        }
        let time = bytes.number()?;
        let last_move = bytes.number()?;
        let nodes = self.state.position.len();
        let mut lists = Vec::new();
        for _ in 0..3 {
            lists.push(bytes.rows::<R, 3>(nodes)?);
        }
        let cells = self.body.mesh.cell_count();
        let history = bytes.rows::<R, 4>(cells)?;
        let mut moving = None;
        if let Some(c) = &self.coupled {
            let numbers = bytes.0.len() / 8;
            let numbers: Vec<f64> = (0..numbers).map(|_| bytes.number()).collect::<Result<_, _>>()?;
            moving = Some(c.now.read(&numbers).ok_or(CheckpointError::Mismatch("another skeleton"))?);
        }
        if !bytes.0.is_empty() {
            return Err(CheckpointError::Mismatch("trailing bytes"));
        }
        let acceleration = lists.pop().unwrap_or_default();
        let velocity = lists.pop().unwrap_or_default();
        let position = lists.pop().unwrap_or_default();
        self.state = State { time, position, velocity, acceleration };
        self.body.model.restore(&history);
        self.solver.forget();
        self.last_move = Some(last_move).filter(|m| !m.is_nan());
        self.pose = motion.pose(time);
        let drive = self.drive(&self.pose);
        self.reset_frames(&drive);
        if let (Some(c), Some(moving)) = (&mut self.coupled, moving) {
            c.now = moving;
            c.stepper.forget();
            c.articulation.base_into(&self.skeleton, &self.pose, &mut c.base);
            c.articulation.pose_into(&self.skeleton, &c.base, &c.now.configuration, &mut self.pose);
        }
        Ok(())
    }
}

pub(super) fn put(out: &mut Vec<u8>, v: f64) {
    out.extend_from_slice(&v.to_le_bytes());
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], CheckpointError> {
        if self.0.len() < n {
            return Err(CheckpointError::Mismatch("cut short"));
        }
        let (head, tail) = self.0.split_at(n);
        self.0 = tail;
        Ok(head)
    }

    fn number(&mut self) -> Result<f64, CheckpointError> {
        let bytes = self.take(8)?;
        Ok(f64::from_le_bytes(bytes.try_into().expect("eight bytes were taken")))
    }

    /// A list that must be empty or have `expected` rows.
    fn rows<R: Scalar, const N: usize>(&mut self, expected: usize) -> Result<Vec<[R; N]>, CheckpointError> {
        let bytes = self.take(8)?;
        let count = u64::from_le_bytes(bytes.try_into().expect("eight bytes were taken"));
        if count != 0 && count != expected as u64 {
            return Err(CheckpointError::Mismatch("another body"));
        }
        (0..count)
            .map(|_| {
                let mut row = [R::zero(); N];
                for v in &mut row {
                    *v = R::from_f64(self.number()?);
                }
                Ok(row)
            })
            .collect()
    }
}
