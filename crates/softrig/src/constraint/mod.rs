//! Constraints beyond prescribed nodes. (Prescribed nodes are `softrig_linalg::DofConstraints`.)
