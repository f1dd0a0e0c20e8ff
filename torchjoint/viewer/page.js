// What viser's page lacks: clicks in the panel's photo and tables, hovering, a title, dark mode, and a phone's layout.
// A line such as `torchjoint:image 12 80 0` goes into a hidden text field, whose text viser sends to the server.
"use strict";
(() => {
  const field = () => [...document.querySelectorAll("input")].find((one) => one.value.startsWith("torchjoint:"));
  const isNew = !window.torchjoint; // else the panel was built anew
  // Of what happens within 50 ms viser sends the first and the last. So a line waits until nothing has for 100 ms.
  const queue = (window.torchjoint ??= { lines: [], timer: 0 });
  const wait = () => {
    clearTimeout(queue.timer);
    queue.timer = setTimeout(next, 100);
  };
  const next = () => {
    queue.timer = 0;
    if (!queue.lines.length) return;
    wait();
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(field(), queue.lines.shift());
    field().dispatchEvent(new Event("input", { bubbles: true })); // as when a user types
  };
  const send = (...words) => {
    queue.lines.push(`torchjoint:${words.join(" ")} ${Date.now()}`); // the time: two clicks in one place are two lines
    if (!queue.timer) next();
  };
  const once = (condition, action) => (condition() ? action() : setTimeout(once, 200, condition, action));
  const matches = (query) => matchMedia(query).matches;

  document.title = [document.getElementById("tj-page").dataset.name, "torchjoint"].filter(Boolean).join(" - ");
  // viser drops what comes before the page's first camera, so this is sent until the page is dark.
  const wanted = Number(matches("(prefers-color-scheme: dark)"));
  const isDark = () => document.documentElement.dataset.mantineColorScheme === "dark";
  once(() => field() && (send("dark", wanted), !wanted || isDark()), () => {});
  if (!wanted) setTimeout(() => field() && send("dark", wanted), 3000); // an earlier page may have been dark
  if (!isNew) return;

  const sheet = () => document.querySelector('[style*="height: 3.5em"][style*="cursor"]'); // viser's panel on a phone
  if (matches("(max-width: 36em)")) {
    once(sheet, () => sheet().click()); // closed at first: the cloud comes first
    setInterval(() => { // what was tapped is told there, too
      const told = document.querySelector("#tj-panel > div")?.textContent.replace("segment ", "") ?? "tap: controls";
      if (sheet() && sheet().dataset.told !== told) sheet().dataset.told = told;
    }, 200);
  }

  document.addEventListener("click", (event) => {
    const more = event.shiftKey ? 1 : 0;
    const { hue, sort } = event.target.closest("[data-hue], [data-sort]")?.dataset ?? {};
    if (hue) send("row", hue, more);
    if (sort) send("sort", sort);
    if (event.target.id !== "tj-image") return;
    const { left, top, width, height } = event.target.getBoundingClientRect();
    const { naturalWidth, naturalHeight } = event.target;
    const column = Math.floor(((event.clientX - left) / width) * naturalWidth);
    send("image", column, Math.floor(((event.clientY - top) / height) * naturalHeight), more);
  });
  const act = (event) => ["Shift", "Control", "Alt", "Meta"].includes(event.key) || wait(); // held keys repeat
  for (const kind of ["click", "input", "keydown"]) document.addEventListener(kind, act, true);

  // The browser gives a finger to the canvas at once; viser takes that for a grip of its own, and would drop the tap.
  document.addEventListener("pointerdown", ({ target, pointerId }) => {
    if (target.tagName === "CANVAS" && target.hasPointerCapture(pointerId)) target.releasePointerCapture(pointerId);
  }, true);

  let rest; // a timer: the mouse is on a thing when it rests there
  let isTold = false;
  document.addEventListener("pointermove", (event) => {
    clearTimeout(rest);
    if (event.buttons) wait();
    const isOver = event.target.tagName === "CANVAS" && event.pointerType === "mouse" && !event.buttons;
    if (!isOver && isTold) send("hover");
    isTold &&= isOver;
    if (!isOver) return;
    const { left, top, width, height } = event.target.getBoundingClientRect();
    rest = setTimeout(() => {
      isTold = true;
      send("hover", (event.clientX - left) / width, (event.clientY - top) / height);
    }, 80);
  });
})();
