// Adds to a page that reads without it: words at the points of plots, and one view of all pictures.
(() => {
  "use strict";

  // A new element with attributes and children.
  const make = (tag, attributes = {}, ...children) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.append(...children);
    return element;
  };

  const root = document.documentElement;

  // Boxes that hold their contents need no stop of the tab key.
  const boxes = [...document.querySelectorAll(".scroll[tabindex], pre[tabindex]")];
  const stops = () => {
    for (const box of boxes) box.tabIndex = box.scrollWidth > box.clientWidth ? 0 : -1;
  };
  addEventListener("resize", stops);
  stops();

  // Words at the points of plots: under the pointer, by a tap, or by the arrow keys.
  const tip = make("div", { class: "tip", "aria-hidden": "true" });
  tip.hidden = true;
  document.body.append(tip);
  let shown = null;

  const hide = () => {
    shown?.classList.remove("on");
    shown = null;
    tip.hidden = true;
  };

  const place = () => {
    if (!shown) return;
    const at = shown.getBoundingClientRect();
    const left = (at.left + at.right - tip.offsetWidth) / 2;
    const above = at.top - tip.offsetHeight - 4;
    tip.style.left = `${Math.max(8, Math.min(left, root.clientWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${above > 8 ? above : at.bottom + 4}px`;
  };

  const show = (hit) => {
    if (hit === shown) return;
    hide();
    shown = hit;
    hit.classList.add("on");
    const [head, ...lines] = hit.dataset.words.split("\n");
    tip.replaceChildren(make("b", {}, head), ...lines.map((line) => make("span", {}, line)));
    tip.hidden = false;
    place();
  };

  const plot = (svg) => {
    const groups = [...svg.querySelectorAll(".hits")].map((group) => [...group.querySelectorAll(".hit")]);
    const hits = groups.flat();
    if (hits.length === 0) return;
    // The browser's own words would show a second time.
    const name = svg.querySelector(":scope > title");
    svg.setAttribute("role", "group");
    svg.setAttribute("aria-label", `${name?.textContent ?? "Plot"}. Arrow keys go from point to point.`);
    name?.remove();
    for (const hit of hits) {
      const title = hit.querySelector("title");
      hit.dataset.words = title.textContent;
      title.remove();
      hit.setAttribute("role", "img");
      hit.setAttribute("aria-label", hit.dataset.words.replaceAll("\n", ", "));
      hit.setAttribute("tabindex", hit === hits[0] ? "0" : "-1");
      hit.addEventListener("focus", () => show(hit));
      hit.addEventListener("blur", hide);
    }
    for (const group of svg.querySelectorAll(".hits")) group.setAttribute("role", "group");
    // Middles of targets of any shape.
    const x = (hit) => hit.getBBox().x + hit.getBBox().width / 2;
    const y = (hit) => hit.getBBox().y + hit.getBBox().height / 2;
    const nearest = (list, distance) => list.reduce((a, b) => (distance(b) < distance(a) ? b : a));

    const point = (event) => {
      const box = svg.getBoundingClientRect();
      const scale = svg.viewBox.baseVal.width / box.width;
      const [px, py] = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
      const away = (hit) => Math.hypot(x(hit) - px, y(hit) - py);
      // Targets overlap, so the nearest counts, not the topmost. A finger is wider than a pointer.
      const near = nearest(hits, away);
      const reach = scale * (event.pointerType === "touch" ? 28 : 18);
      const hit = away(near) < reach ? near : event.target.closest(".hit");
      if (hit) show(hit);
      else hide();
    };
    svg.addEventListener("pointermove", point);
    svg.addEventListener("pointerdown", point);
    svg.addEventListener("pointerleave", (event) => {
      if (event.pointerType !== "touch") hide();
    });

    svg.addEventListener("keydown", (event) => {
      const row = groups.findIndex((group) => group.includes(event.target));
      if (row < 0) return;
      const group = groups[row];
      const place = group.indexOf(event.target);
      const across = (list) => list && nearest(list, (hit) => Math.abs(x(hit) - x(event.target)));
      const next = {
        ArrowRight: () => group[place + 1],
        ArrowLeft: () => group[place - 1],
        ArrowDown: () => across(groups[row + 1]),
        ArrowUp: () => across(groups[row - 1]),
        Home: () => group[0],
        End: () => group.at(-1),
      }[event.key];
      if (!next) return;
      event.preventDefault();
      const hit = next();
      if (!hit) return;
      for (const other of hits) other.setAttribute("tabindex", other === hit ? "0" : "-1");
      hit.focus();
    });
  };

  document.querySelectorAll(".plot svg").forEach(plot);
  addEventListener("scroll", place, { passive: true, capture: true });
  addEventListener("resize", hide);
  document.addEventListener("pointerdown", (event) => {
    if (!event.target.closest(".plot svg")) hide();
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") hide();
  });

  // One view of all pictures: a method, a setting, and a slider from the method's image over the truth to the
  // difference.
  const viewer = (box) => {
    const picture = (figure) => ({
      setting: Number(figure.dataset.setting),
      src: figure.querySelector("img").src,
      words: figure.querySelector("figcaption").textContent,
    });
    const truthFigure = box.querySelector("[data-role=truth]");
    const series = [...box.querySelectorAll(".series")].map((part) => {
      const of = (role) => [...part.querySelectorAll(`[data-role=${role}]`)].map(picture);
      const differences = of("difference");
      const shots = of("image").map((image) => ({
        ...image,
        difference: differences.find((difference) => difference.setting === image.setting),
      }));
      return { label: part.dataset.label, shots: shots.filter((shot) => shot.difference) };
    }).filter((part) => part.shots.length > 0);
    if (!truthFigure || series.length === 0) return;
    const truth = picture(truthFigure);
    // As stated, not as laid out.
    const [width, height] = ["width", "height"].map((side) => Number(truthFigure.querySelector("img").getAttribute(side)));
    const steps = 20;
    const names = ["Method", "Truth", "Difference"];

    const method = make("select", { class: "method" }, ...series.map((part, i) => make("option", { value: i }, part.label)));
    const setting = make("input", { type: "range", class: "setting", min: 0, step: 1 });
    const settingWords = make("output");
    const mix = make("input", { type: "range", class: "mix", min: 0, max: 2 * steps, step: 1, value: 0 });
    const stops = names.map((name, i) => {
      const stop = make("button", { type: "button" }, name);
      stop.addEventListener("click", () => {
        mix.value = i * steps;
        update();
      });
      return stop;
    });
    // Decoded at once, so that no empty frame flashes between two pictures.
    const layer = (role) => make("img", { class: role, alt: "", width, height, decoding: "sync" });
    const layers = { image: layer("image"), truth: layer("truth"), difference: layer("difference") };
    layers.truth.src = truth.src;
    // Small pictures are magnified by a whole number, so that every pixel is seen as a square.
    const times = Math.max(1, Math.floor(480 / width));
    const stage = make("div", { class: times > 1 ? "stage squares" : "stage", role: "img" }, ...Object.values(layers));
    const wide = `${times * width}px`;
    stage.style.width = wide;
    stage.style.aspectRatio = `${width} / ${height}`;
    const caption = make("figcaption");
    const all = make("button", { type: "button", class: "all", "aria-expanded": "false" });

    const update = () => {
      const part = series[method.value];
      const shot = part.shots[setting.value];
      const at = Number(mix.value) / steps;
      layers.image.src = shot.src;
      layers.difference.src = shot.difference.src;
      layers.truth.style.opacity = Math.min(at, 1);
      layers.difference.style.opacity = Math.max(at - 1, 0);
      const state = [
        `${part.label}, ${shot.words}`,
        truth.words,
        `${part.label} minus truth, ${shot.words}`,
      ];
      const low = Math.min(Math.floor(at), 1);
      const share = Math.round(100 * (at - low));
      const words = share === 0 ? state[low] : share === 100 ? state[low + 1]
        : `${100 - share} % ${names[low].toLowerCase()}, ${share} % ${names[low + 1].toLowerCase()}: ${part.label}, ${shot.words}`;
      settingWords.textContent = shot.setting.toLocaleString("en");
      setting.setAttribute("aria-valuetext", shot.words);
      mix.setAttribute("aria-valuetext", words);
      stage.setAttribute("aria-label", words);
      if (caption.textContent !== words) caption.textContent = words;
      stops.forEach((stop, i) => stop.setAttribute("aria-pressed", String(at === i)));
    };
    // Another method has other settings: the nearest one is kept.
    let wanted = series[0].shots.at(-1).setting;
    const choose = () => {
      const { shots } = series[method.value];
      const away = (shot) => Math.abs(Math.log(shot.setting / wanted));
      setting.max = shots.length - 1;
      setting.value = shots.reduce((best, shot, i) => (away(shot) < away(shots[best]) ? i : best), 0);
      update();
    };
    method.addEventListener("change", choose);
    setting.addEventListener("input", () => {
      wanted = series[method.value].shots[setting.value].setting;
      update();
    });
    mix.addEventListener("input", update);
    // Let go near a stop means the stop.
    mix.addEventListener("pointerup", () => {
      const stop = Math.round(mix.value / steps) * steps;
      if (Math.abs(mix.value - stop) === 1) mix.value = stop;
      update();
    });

    const flip = (open) => {
      box.classList.toggle("open", open);
      all.setAttribute("aria-expanded", String(open));
      all.textContent = open ? "Hide the side-by-side pictures" : "Show all pictures side by side";
    };
    all.addEventListener("click", () => flip(!box.classList.contains("open")));
    flip(false);

    const mixer = make("div", { class: "mixer" },
      make("label", {}, make("span", {}, "From the method over the truth to the difference"), mix),
      make("div", { class: "stops" }, ...stops));
    mixer.style.width = wide;
    box.prepend(make("div", { class: "view" },
      make("div", { class: "controls" },
        make("label", {}, "Method", method),
        make("label", {}, box.dataset.setting, setting, settingWords)),
      make("figure", {}, stage, caption),
      mixer,
      all));
    box.classList.add("live");
    choose();
  };

  document.querySelectorAll(".viewer").forEach(viewer);
})();
