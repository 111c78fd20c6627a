//! What a process does about panics is not for a library to change: one test alone, because the hook is of the whole process.

use std::panic::{set_hook, take_hook};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use whirlstand_logs::{Mapping, info, read};

#[test]
fn a_damaged_ulog_is_an_error_and_the_panic_hook_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lengths.ulg");
    let mut bytes = b"ULog\x01\x12\x35\x01".to_vec();
    bytes.extend(1_000_000u64.to_le_bytes());
    // A parameter whose name is said to have 200 characters, in a message of 4 bytes.
    bytes.extend([4, 0, b'P', 200, b'a', b'b', b'c']);
    std::fs::write(&path, bytes).unwrap();

    let panics = Arc::new(AtomicU32::new(0));
    let counted = panics.clone();
    let own: Box<dyn Fn(&std::panic::PanicHookInfo<'_>) + Send + Sync> = Box::new(move |_| {
        counted.fetch_add(1, Ordering::Relaxed);
    });
    let address: *const () = (&raw const *own).cast();
    set_hook(own);
    let told = info(&path).map(|_| ()).map_err(|e| e.to_string());
    let taken = read(&path, &[] as &[Mapping]).map(|_| ()).map_err(|e| e.to_string());
    let left = take_hook();

    assert_eq!((&raw const *left).cast::<()>(), address, "reading a log replaced the panic hook");
    assert_eq!(panics.load(Ordering::Relaxed), 0, "the parser panicked");
    for result in [told, taken] {
        let error = result.unwrap_err();
        assert!(error.contains("lengths.ulg"), "{error}");
    }
}
