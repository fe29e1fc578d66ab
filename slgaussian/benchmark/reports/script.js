"use strict";
// Without this script the page has all its pictures and numbers: it enlarges and slides.
const large = document.createElement("dialog");
large.className = "large";
document.body.append(large);
large.addEventListener("click", () => large.close());
for (const picture of document.querySelectorAll("figure img")) {
  picture.tabIndex = 0;
  picture.setAttribute("role", "button");
  picture.classList.add("enlarges");
  const show = () => {
    const copy = picture.cloneNode();
    copy.removeAttribute("class");
    copy.removeAttribute("role");
    const caption = document.createElement("p");
    const title = picture.closest(".card")?.querySelector("header b")?.textContent;
    const text = picture.parentElement.querySelector("figcaption")?.textContent ?? picture.alt;
    caption.textContent = [title, text].filter(Boolean).join(": ") + " (Esc or a click closes)";
    large.replaceChildren(copy, caption);
    large.showModal();
  };
  picture.addEventListener("click", show);
  picture.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") { event.preventDefault(); show(); }
  });
}
for (const walk of document.querySelectorAll(".walk")) {
  const [strip, slider] = [walk.querySelector(".strip"), walk.querySelector("input")];
  slider.hidden = false;
  slider.addEventListener("input", () => { strip.scrollLeft = slider.value * strip.clientWidth; });
  strip.addEventListener("scroll", () => {
    slider.value = Math.round(strip.scrollLeft / strip.clientWidth);
  });
}
for (const link of document.querySelectorAll('a[href^="#"]')) {
  link.addEventListener("click", () => {
    const folded = document.getElementById(link.hash.slice(1))?.closest("details");
    if (folded) folded.open = true;
  });
}
