//! The firmware's parameter page, on the host: what was written for another image is refused, never misread.

#[path = "../../stillflux-firmware/src/blob.rs"]
#[allow(dead_code)]
mod blob;
#[path = "../../stillflux-firmware/src/page.rs"]
#[allow(dead_code)]
mod page;

use blob::{Parameters, crc};
use page::{Page, Ready, WORDS};
use stillflux::config::Scheme;
use stillflux::scalar::{Q, Real};
use stillflux::words::Words;

fn ready<R: Real + Words>(scheme: Scheme) -> Ready<R> {
    Ready::new(&Parameters::preset(scheme)).unwrap()
}

/// The page with one word changed and its check made right again.
fn changed(page: &Page, at: usize, to: impl Fn(u32) -> u32) -> Page {
    let mut words = *page.words();
    words[at] = to(words[at]);
    words[WORDS - 1] = crc(&words);
    Page::new(words)
}

fn comes_back<R: Real + Words>() {
    for &scheme in Scheme::ALL {
        let ready = ready::<R>(scheme);
        assert_eq!(Page::seal(&ready).unwrap().open::<R>(), Some(ready));
    }
}

#[test]
fn a_page_comes_back_as_it_was_sealed() {
    comes_back::<f32>();
    comes_back::<Q>();
}

#[test]
fn a_page_of_another_image_is_refused() {
    let page = Page::seal(&ready::<f32>(Scheme::default())).unwrap();
    assert!(page.open::<Q>().is_none(), "arithmetic");
    for built in 0..8 {
        let other = changed(&page, 2, |_| built);
        assert_eq!(other.open::<f32>().is_some(), built == Scheme::BUILT, "schemes {built:b}");
    }
    assert!(changed(&page, 0, |w| w ^ 1).open::<f32>().is_none(), "magic");
    assert!(changed(&page, 3, |n| n - 1).open::<f32>().is_none(), "length");
    assert!(changed(&page, 3, |n| n).open::<f32>().is_some());
    let mut torn = *page.words();
    torn[20] ^= 1;
    assert!(Page::new(torn).open::<f32>().is_none(), "check");
}
