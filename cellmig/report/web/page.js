/* Puts a page together: player and its controls, charts, and news of a run that goes on. */
"use strict";

const POLL = 2000;  // between questions for news [ms]
const data = () => JSON.parse(byId("data").textContent);

/* --------------------------------------------------------------------------------------------------------- controls */

let player = null;  // that of the page; keys and a page that renews itself need it

function fillMenu(menu, options, chosen) {
    menu.replaceChildren(...options.map(([value, text]) => new Option(text, value, false, value === chosen)));
}

/* Menus of fields, parts and arrows, as they were chosen before if that is still there. */
async function setUpMenus(before) {
    const fields = player.fields, [field, part, arrows] = ["field", "part", "arrows"].map(byId);
    const names = Object.keys(fields).sort((a, b) => fields[a].label.localeCompare(fields[b].label));
    const chosen = [before.field, "effective_stress"].find(name => name in fields) ?? names[0];
    fillMenu(field, names.map(name => [name, fields[name].label]), chosen);
    fillMenu(arrows, [["", "none"], ...names.filter(name => isVector(fields[name].parts)).map(name => [name, fields[name].label])],
             before.arrows);
    const choose = async wanted => {
        const parts = player.partsOf(field.value);
        fillMenu(part, parts.map(one => [one, one]), parts.includes(wanted) ? wanted : parts[0]);
        byId("part-label").hidden = parts.length < 2;
        field.title = fields[field.value].meaning;
        await player.choose(field.value, part.value);
    };
    field.onchange = () => choose();
    part.onchange = () => player.choose(field.value, part.value);
    arrows.onchange = () => player.arrowsOf(arrows.value);
    await choose(before.part);
    if (arrows.value) await player.arrowsOf(arrows.value);
}

function setUpControls(before) {
    player.options = {};
    for (const name of ["outlines", "levels", "tracks", "behind", "follow"]) {
        const box = byId(name), read = () => { player.options[name] = box.checked; player.draw(); };
        box.checked = before.options?.[name] ?? box.checked;
        box.onchange = read;
        read();
    }
    byId("follow-label").hidden = !player.far;
    byId("follow").addEventListener("change", () => player.resize());  // another box, of another height
    byId("behind-label").hidden = !player.behind;
    byId("behind-label").querySelector("span").textContent = player.movie.behind?.label ?? "";
    const flat = player.movie.dimension === 2;
    document.querySelectorAll(".flat").forEach(one => { one.hidden = !flat; });
    document.querySelectorAll(".space").forEach(one => { one.hidden = flat; });
    const slider = byId("time");
    slider.max = player.times.length - 1;
    slider.oninput = () => { player.play(false); player.seek(Number(slider.value)); };
    byId("play").onclick = () => player.play();
    byId("closer").onclick = () => { player.view.zoomAt(1.3); player.draw(); };
    byId("farther").onclick = () => { player.view.zoomAt(1 / 1.3); player.draw(); };
    byId("home").onclick = () => { player.view.home(); player.draw(); };
    player.listeners.push(() => {
        slider.value = player.frame;
        const clock = `${shown(player.time)} ${player.movie.unit}`;
        byId("clock").value = `${clock}, ${player.frame + 1} of ${player.times.length}`;
        slider.setAttribute("aria-valuetext", clock);
        byId("play").textContent = player.playing ? "❚❚" : "▶";
        byId("play").setAttribute("aria-label", player.playing ? "Pause" : "Play");
        byId("stage").setAttribute("aria-label", `Cells filled with ${player.label} at ${clock}; the table below has numbers`);
        const ends = player.beyond.some(Boolean) ? "; beyond the ends: 1 % of the values each" : "";
        drawBar(byId("bar"), { ...player.range, label: player.label + ends });
        if (!player.playing) fillNow();
    });
    const own = player;  // a page that renews itself takes another, and this one out of the page
    new ResizeObserver(() => own === player && own.resize()).observe(byId("stage").parentElement);
    setUpPointer(byId("stage"));
}

const KEYS = {
    " ": () => player.play(), ArrowLeft: () => { player.play(false); player.seek(player.frame - 1); },
    ArrowRight: () => { player.play(false); player.seek(player.frame + 1); }, Home: () => player.seek(0),
    End: () => player.seek(Infinity), "+": () => byId("closer").click(), "=": () => byId("closer").click(),
    "-": () => byId("farther").click(), 0: () => byId("home").click(),
};

document.addEventListener("keydown", event => {
    const busy = event.target.closest?.("select, input, button, summary, a, pre") && event.target.id !== "stage";
    if (!player || busy || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.shiftKey && event.key.startsWith("Arrow")) {
        const [dx, dy] = { ArrowLeft: [-30, 0], ArrowRight: [30, 0], ArrowUp: [0, -30], ArrowDown: [0, 30] }[event.key];
        turnOrMove(dx, dy, player.movie.dimension === 3);
    } else if (KEYS[event.key]) KEYS[event.key]();
    else return;
    event.preventDefault();
});

function turnOrMove(dx, dy, turn) {
    if (turn) player.view.turn(dx, dy); else player.view.move(dx, dy);
    player.draw();
}

/* One pointer moves or turns, two zoom; one that is not down asks for values. */
function setUpPointer(canvas) {
    const down = new Map(), at = event => [event.offsetX, event.offsetY];
    canvas.onpointerdown = event => {
        canvas.setPointerCapture(event.pointerId);
        down.set(event.pointerId, at(event));
        canvas.focus({ preventScroll: true });
        if (event.pointerType === "touch") tellValues(...at(event));
    };
    canvas.onpointermove = event => {
        const before = down.get(event.pointerId), now = at(event);
        if (!before) { tellValues(...now); return; }
        const others = [...down].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
        down.set(event.pointerId, now);
        if (others.length) {
            const far = place => Math.hypot(place[0] - others[0][0], place[1] - others[0][1]);
            player.view.zoomAt(far(now) / (far(before) || 1), ...others[0]);
            player.draw();
        } else turnOrMove(now[0] - before[0], now[1] - before[1], player.movie.dimension === 3 && !event.shiftKey);
    };
    canvas.onpointerup = canvas.onpointercancel = event => down.delete(event.pointerId);
    canvas.onpointerleave = () => { byId("values").hidden = true; };
    canvas.addEventListener("wheel", event => {
        if (document.activeElement !== canvas && !event.ctrlKey) return;
        event.preventDefault();
        player.view.zoomAt(Math.exp(-0.0015 * event.deltaY), ...at(event));
        player.draw();
    }, { passive: false });
}

async function tellValues(x, y) {
    const box = byId("values"), found = player.nearest(x, y);
    tellValues.last = found;
    if (found < 0) { box.hidden = true; return; }
    const rows = await player.about(found);
    if (tellValues.last !== found) return;
    const cell = player.movie.cells[player.cell[found]], material = player.movie.materials[player.material[found]] ?? "";
    const head = document.createElement("b");
    head.textContent = `${cell}, particle ${player.ids[found]}${material ? `, ${material}` : ""}`;
    box.replaceChildren(head, ...rows.flatMap(([name, text]) => [document.createTextNode(`${name}: ${text}`), document.createElement("br")]));
    box.hidden = false;
    const right = x > player.view.width / 2;
    Object.assign(box.style, { left: right ? "" : `${x + 16}px`, right: right ? `${player.view.width - x + 16}px` : "",
                               top: `${Math.max(0, Math.min(y - 20, player.view.height - box.offsetHeight))}px` });
}

/* The frame in numbers: a row for each cell. */
function fillNow() {
    const table = byId("now"), values = player.shownValues[player.frame], cells = new Map();
    player.cell.forEach((cell, i) => {
        const one = cells.get(cell) ?? cells.set(cell, { n: 0, sum: 0, low: Infinity, high: -Infinity, x: player.x.map(() => 0) }).get(cell);
        player.x.forEach((axis, k) => { one.x[k] += axis[player.frame][i]; });
        one.n += 1;
        if (!Number.isFinite(values[i])) return;
        one.sum += values[i];
        one.low = Math.min(one.low, values[i]);
        one.high = Math.max(one.high, values[i]);
    });
    const of = player.movie.dimension === 3 ? " on the surface" : "";
    const head = ["cell", ...["x", "y", "z"].slice(0, player.x.length).map(axis => `${axis} [µm]`), `${player.label}: mean${of}`, "least", "largest"];
    const row = (tag, texts) => {
        const line = document.createElement("tr");
        line.append(...texts.map(text => Object.assign(document.createElement(tag), { textContent: text })));
        return line;
    };
    if (!table.tHead || table.tHead.textContent !== head.join("")) {
        const top = document.createElement("thead"), line = row("th", head.map(() => ""));
        [...line.cells].forEach((cell, k) => cell.append(Object.assign(document.createElement("button"), { type: "button", textContent: head[k] })));
        top.append(line);
        table.replaceChildren(top, document.createElement("tbody"));
    }
    table.tBodies[0].replaceChildren(...[...cells].map(([cell, one]) => row("td", [
        player.movie.cells[cell], ...one.x.map(sum => shown(sum / one.n)), shown(one.sum / one.n), shown(one.low), shown(one.high)])));
    const sorted = [...table.tHead.rows[0].cells].findIndex(cell => cell.hasAttribute("aria-sort"));
    if (sorted >= 0) sortBy(table, sorted, table.tHead.rows[0].cells[sorted].getAttribute("aria-sort") === "descending");
}

/* ------------------------------------------------------------------------------------------------------- the page */

async function start(before = {}) {
    const d = data(), marks = [];
    player = null;
    if (d?.movie) {
        player = await Player.of(d.movie, d.tracks);
        setUpControls(before);
        await setUpMenus(before);
        player.seek(before.frame ?? Infinity);
        if (before.view) Object.assign(player.view, before.view);
        player.resize();
    }
    if (d?.stills) await showStills(document.querySelector("[data-stills]"), d.stills);
    const seek = time => player?.seekTime(time);
    const place = name => document.querySelector(`[data-chart="${name}"]`);
    for (const chart of d?.charts ?? []) marks.push(await tableCharts(place(chart.name), chart, seek));
    if (d?.ledger) marks.push(await ledgerCharts(place("ledger"), d.ledger, seek));
    if (d?.traction) {
        const show = await tractionChart(place("traction"), d.traction);
        marks.push(() => show(player.frame, d.unit));
    }
    player?.listeners.push(() => marks.forEach(mark => mark(player.time)));
    player?.draw();
    document.documentElement.dataset.ready = "yes";
    return d?.live;
}

/* What a reader chose; the last frame stays the last one. */
function chosen() {
    if (!player) return {};
    const last = player.frame === player.times.length - 1, { zoom, moved, azimuth, elevation } = player.view;
    return { options: player.options, field: byId("field").value, part: byId("part").value, arrows: byId("arrows").value,
             frame: last ? undefined : player.frame, view: { zoom, moved, azimuth, elevation } };
}

/* Take the parts of a new page; what was chosen, has the focus, is open and is in sight stays. */
async function renew(fresh) {
    const before = chosen(), root = document.documentElement.style, top = scrollY, focused = document.activeElement.id;
    const open = [...document.querySelectorAll("main details")].some(one => one.open);
    Object.assign(root, { minHeight: `${document.documentElement.scrollHeight}px`, overflowAnchor: "none" });
    document.querySelector("main").replaceWith(fresh.querySelector("main"));
    document.querySelectorAll("main details").forEach(one => { one.open = open; });
    for (const id of ["lead", "data"]) byId(id).replaceWith(fresh.getElementById(id));
    document.querySelector("nav").replaceWith(fresh.querySelector("nav"));
    if (focused) byId(focused)?.focus({ preventScroll: true });
    await start(before);
    Object.assign(root, { minHeight: "", overflowAnchor: "" });
    scrollTo(0, top);
}

/* Ask for news; where there are some, take the new page's parts. */
async function watch() {
    let known = "";
    for (;;) {
        await new Promise(done => setTimeout(done, POLL));
        try {
            const state = await (await fetch("state.json")).text();
            if (state === known || player?.playing) continue;
            const begun = performance.now(), answer = await fetch("./");
            if (!answer.ok) {
                byId("lead").textContent = "Files of the run are being replaced, or were taken away; this is what was known last.";
                continue;
            }
            const text = await answer.text();
            await renew(new DOMParser().parseFromString(text, "text/html"));
            known = state;
            await new Promise(done => setTimeout(done, 4 * (performance.now() - begun)));  // the run needs its cores
        } catch (error) {
            byId("lead").textContent = "The server has ended; this is what was known last.";
            known = "";  // should it come back
        }
    }
}

if (typeof DecompressionStream === "undefined")
    byId("lead").textContent += " This browser is too old to show frames and curves.";
else start().then(live => live && watch());
