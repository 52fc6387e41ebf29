//! The firmware chapter tells the engineer about every fault under its number and text.

use stillflux::drive::Fault;

#[test]
fn the_firmware_chapter_lists_every_fault_under_its_number_and_text_and_no_other() {
    let chapter = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/firmware.md")).unwrap();
    let rows: Vec<(u32, &str)> = chapter
        .lines()
        .skip_while(|line| *line != "## Faults")
        .filter_map(|line| {
            let mut cells = line.strip_prefix('|')?.split('|').map(str::trim);
            Some((cells.next()?.parse().ok()?, cells.next()?))
        })
        .collect();
    let faults: Vec<_> = Fault::ALL.iter().map(|fault| (fault.code(), fault.text())).collect();
    assert_eq!(rows, faults);
}
