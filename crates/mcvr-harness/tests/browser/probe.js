// Looks at a report in frames of a phone's and a desk's width, works its controls, and leaves what it found in the
// document, as base64 of JSON. The test puts `PAGE` (address) and `MODE` in front.
(async () => {
  "use strict";
  const found = {};
  const later = (ms) => new Promise((done) => setTimeout(done, ms));
  const frame = (width, sandbox) => new Promise((done) => {
    const frame = document.createElement("iframe");
    if (sandbox) frame.sandbox = sandbox;
    Object.assign(frame, { width, height: 800, src: PAGE });
    frame.style.border = "0";
    frame.style.display = "block";
    frame.onload = () => done(frame);
    document.body.append(frame);
  });
  const fire = (element, type, init = {}) => {
    const { defaultView: view } = element.ownerDocument;
    const kind = type.startsWith("pointer") ? view.PointerEvent : type.startsWith("key") ? view.KeyboardEvent : view.Event;
    element.dispatchEvent(new kind(type, { bubbles: true, cancelable: true, ...init }));
  };
  const visible = (element) => element.getClientRects().length > 0;

  // What holds at any width, with and without a script.
  const layout = (page) => {
    const { document: doc } = page;
    const all = (selector) => [...doc.querySelectorAll(selector)];
    // A frame's load event waits for its pictures.
    const pictures = all(".gallery img").map((img) =>
      img.complete && img.naturalWidth > 0 && img.naturalWidth === Number(img.getAttribute("width")));
    return {
      live: doc.querySelector(".view") !== null,
      scrollWidth: doc.documentElement.scrollWidth,
      clientWidth: doc.documentElement.clientWidth,
      tooWide: all("main, main > *, section > *, header > *, .view *").filter((element) =>
        visible(element) && element.getBoundingClientRect().right > page.innerWidth + 0.5
      ).map((element) => element.outerHTML.slice(0, 80)),
      levels: all("h1, h2, h3").filter(visible).map((heading) => Number(heading.tagName[1])),
      links: all("nav a").map((link) => doc.querySelector(link.getAttribute("href"))?.textContent === link.textContent),
      tables: all("table").filter(visible).length,
      unscoped: all("th:not([scope])").length,
      plots: all(".plot svg").filter(visible).map((svg) => svg.getAttribute("width")),
      titles: all(".hit > title").map((title) => title.textContent),
      pictures,
      shownPictures: all(".gallery img").filter(visible).length,
      back: page.getComputedStyle(doc.body).backgroundColor,
      ink: page.getComputedStyle(doc.body).color,
      plotBack: page.getComputedStyle(doc.querySelector(".plot svg rect")).fill,
      plotInk: page.getComputedStyle(doc.querySelector(".plot svg text")).fill,
      fetched: page.performance.getEntriesByType("resource").map((entry) => entry.name)
        .filter((name) => !name.startsWith("data:")),
    };
  };

  // Words at points: by the keyboard's focus, by its arrows, by the pointer.
  const words = (page) => {
    const { document: doc } = page;
    const tip = doc.querySelector(".tip");
    const svg = [...doc.querySelectorAll(".plot svg")].find(visible);
    const hits = [...svg.querySelectorAll(".hit")];
    const state = () => {
      const box = tip.getBoundingClientRect();
      return {
        words: visible(tip) ? [...tip.children].map((line) => line.textContent).join("\n") : null,
        inside: box.left >= 0 && box.top >= 0 && box.right <= page.innerWidth && box.bottom <= page.innerHeight,
      };
    };
    const result = { stops: hits.filter((hit) => hit.getAttribute("tabindex") === "0").length };
    svg.scrollIntoView({ block: "center" });
    result.before = state();
    hits[0].focus();
    result.focused = state();
    fire(hits[0], "keydown", { key: "ArrowRight" });
    result.right = { ...state(), moved: doc.activeElement === hits[1] };
    fire(hits[1], "keydown", { key: "ArrowDown" });
    result.down = { ...state(), moved: doc.activeElement.parentNode !== hits[1].parentNode };
    fire(doc.activeElement, "keydown", { key: "Escape" });
    result.escaped = state();
    const last = hits.at(-1);
    const at = last.getBoundingClientRect();
    const middle = { clientX: (at.left + at.right) / 2, clientY: (at.top + at.bottom) / 2, pointerType: "mouse" };
    fire(svg, "pointermove", middle);
    result.pointed = state();
    const field = svg.getBoundingClientRect();
    fire(svg, "pointermove", { clientX: field.left + 1, clientY: field.top + 1, pointerType: "mouse" });
    result.away = state();
    fire(svg, "pointerdown", { ...middle, pointerType: "touch" });
    fire(svg, "pointerleave", { pointerType: "touch" });
    result.tapped = state();
    fire(doc.querySelector("h1"), "pointerdown", { pointerType: "touch" });
    result.tappedElsewhere = state();
    result.label = last.getAttribute("aria-label");
    return result;
  };

  const view = (page) => {
    const { document: doc } = page;
    const one = (selector) => doc.querySelector(`.view ${selector}`);
    const still = (series, role) => [...doc.querySelectorAll(".series")][series]
      .querySelectorAll(`[data-role=${role}] img`);
    const state = () => ({
      opacity: ["image", "truth", "difference"].map((role) => Number(page.getComputedStyle(one(`img.${role}`)).opacity)),
      caption: one("figcaption").textContent,
      spoken: one(".mix").getAttribute("aria-valuetext"),
      setting: one(".setting").getAttribute("aria-valuetext"),
      pressed: [...doc.querySelectorAll(".stops button")].map((stop) => stop.getAttribute("aria-pressed") === "true"),
      image: one("img.image").src,
      difference: one("img.difference").src,
    });
    const set = (selector, value, type) => {
      one(selector).value = value;
      fire(one(selector), type);
      return state();
    };
    const short = (seen, series, shot) => ({
      ...seen,
      image: seen.image === still(series, "image")[shot].src,
      difference: seen.difference === still(series, "difference")[shot].src,
    });
    const many = still(0, "image").length;
    const result = { many, methods: one(".method").options.length, start: short(state(), 0, many - 1) };
    result.half = short(set(".mix", 10, "input"), 0, many - 1);
    result.truth = short(set(".mix", 20, "input"), 0, many - 1);
    result.difference = short(set(".mix", 40, "input"), 0, many - 1);
    result.first = short(set(".setting", 0, "input"), 0, 0);
    result.other = short(set(".method", 2, "change"), 2, 0);
    doc.querySelectorAll(".stops button")[0].click();
    result.button = short(state(), 2, 0);
    doc.querySelector(".all").click();
    result.shownPictures = [...doc.querySelectorAll(".gallery img")].filter(visible).length;
    return result;
  };

  const downloads = (page) => Promise.all([...page.document.querySelectorAll("a[download]")].map(async (link) => {
    const packed = (await fetch(link.href)).body;
    const zipped = link.download.endsWith(".gz");
    const plain = zipped ? packed.pipeThrough(new DecompressionStream("gzip")) : packed;
    return { name: link.download, text: await new Response(plain).text() };
  }));

  try {
    if (MODE === "work") {
      found.layout = {};
      for (const width of [375, 1280]) {
        const page = (await frame(width)).contentWindow;
        found.layout[width] = layout(page);
        page.focus();
        (found.words ??= {})[width] = words(page);
      }
      const page = (await frame(375)).contentWindow;
      found.view = view(page);
      found.open = layout(page);
      found.downloads = await downloads(page);
    } else if (MODE === "look") {
      found.layout = { 375: layout((await frame(375)).contentWindow) };
    } else if (MODE === "still") {
      found.layout = { 375: layout((await frame(375, "allow-same-origin")).contentWindow) };
    } else {
      // Nothing but the viewer's picture, at a stop of its slider, for a screenshot.
      const page = (await frame(700)).contentWindow;
      const mix = page.document.querySelector(".view .mix");
      mix.value = MODE;
      fire(mix, "input");
      const stage = page.document.querySelector(".stage");
      Object.assign(stage.style, { position: "fixed", left: "0", top: "0", zIndex: 9 });
      document.body.style.margin = "0";
      while (![...stage.querySelectorAll("img")].every((img) => img.complete)) await later(10);
    }
  } catch (error) {
    found.error = String(error.stack ?? error);
  }
  const bytes = new TextEncoder().encode(JSON.stringify(found));
  const text = document.createElement("pre");
  text.id = "found";
  text.hidden = true;
  text.textContent = btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  document.body.append(text);
})();
