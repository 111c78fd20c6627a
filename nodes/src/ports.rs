//! Receives messages and skips damaged ones.

use whirlstand_bus::{RecvError, Subscriber};
use whirlstand_msgs::Message;

use crate::error::NodeError;
use crate::notices::{Notice, say};

/// The next message; one of another version or with damaged content is counted in `refused` and skipped.
///
/// # Errors
/// The transport fails.
#[inline]
pub(crate) fn receive<M: Message>(
    subscriber: &mut Subscriber<M>,
    refused: &mut u64,
) -> Result<Option<M>, NodeError> {
    loop {
        match subscriber.try_recv() {
            Ok(message) => return Ok(message),
            Err(e @ RecvError::Refused { .. }) => {
                // The first one is described, the others are only counted.
                if *refused == 0 {
                    say(Notice::Damaged(e));
                }
                *refused += 1;
            }
            Err(e) => return Err(e.into()),
        }
    }
}
