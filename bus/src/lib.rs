//! How messages travel: one publish/subscribe interface over iceoryx2, Zenoh and in-process.
