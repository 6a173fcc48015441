/* Curves by uPlot: a chart of columns of a table, with a line for each cell, or of the energies. */
"use strict";

const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];  // Okabe and Ito
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3]];  // tell lines apart without colours
const dashOf = k => DASHES[(k + Math.floor(k / COLOURS.length)) % DASHES.length];
const HEIGHT = 220;

/* A line as the background of its mark in a legend. */
function stroke(colour, dash) {
    let at = 0;
    const parts = (dash.length ? dash : [1, 0]).map((long, k) => `${k % 2 ? "transparent" : colour} ${at}px ${at += long}px`);
    return `repeating-linear-gradient(90deg, ${parts.join(", ")})`;
}

const SYNC = "time";

/* A chart in `parent`.  lines: {label, values} each, values as long as x;  limit: of the vertical axis either way. */
function lineChart(parent, { x, unit, lines, axis, along = "time", limit = 0, seek = null, height = HEIGHT }) {
    const place = document.createElement("div");
    place.className = "chart";
    parent.append(place);
    const series = [{ label: `${along} [${unit}]`, value: (u, v) => (v == null ? "–" : shown(v)) }, ...lines.map((line, k) => ({
        label: line.label, stroke: COLOURS[k % COLOURS.length], dash: dashOf(k),
        width: 1.6, points: { show: x.length < 30 }, spanGaps: false, value: (u, v) => (v == null ? "–" : shown(v)) }))];
    const columns = lines.map(line => Array.from(line.values, value => (Number.isFinite(value) ? value : null)));
    const range = (u, low, high) => {
        if (low === null) return [0, 1];
        if (limit) [low, high] = [Math.max(low, -limit), Math.min(high, limit)];
        const around = 0.06 * (high - low) || Math.abs(high) * 0.1 || 1;
        return [low - around, high + around];
    };
    const values = (u, splits, index, space, step) => {
        const digits = Math.ceil(Math.log10(Math.max(...splits.map(Math.abs), step) / step)) + 2;
        return splits.map(value => shown(value, Math.min(12, Math.max(1, digits))));
    };
    const chart = new uPlot({
        width: Math.max(200, place.clientWidth), height, series, focus: { alpha: 0.35 },
        cursor: { sync: seek ? { key: SYNC, setSeries: false } : undefined, focus: { prox: 20 } },
        scales: { x: { time: false }, y: { range } }, hooks: { draw: [chart => chart.mark?.()] },
        axes: [{ label: `${along} [${unit}]`, size: 34, labelSize: 18, labelGap: 0, values, font: "11px system-ui, sans-serif" },
               { label: axis, size: 62, labelSize: 18, values, font: "11px system-ui, sans-serif" }],
    }, [Array.from(x), ...columns], place);
    new ResizeObserver(() => chart.setSize({ width: Math.max(200, place.clientWidth), height })).observe(place);
    chart.root.querySelectorAll(".u-legend .u-marker").forEach((mark, k) => {
        if (k) mark.style.background = stroke(series[k].stroke, series[k].dash);
    });
    chart.root.setAttribute("role", "img");
    chart.root.setAttribute("aria-label", `${axis} against ${along}: ${lines.slice(0, 8).map(line => line.label).join(", ")}`);
    if (seek && player) {
        chart.over.addEventListener("click", () => chart.cursor.idx != null && seek(x[chart.cursor.idx]));
        const mark = document.createElement("div");
        mark.className = "at";
        chart.over.append(mark);
        let last = NaN;
        chart.mark = (time = last) => {  // out of sight where it is beyond the axis, such as of a part that was zoomed in on
            const at = chart.valToPos(last = time, "x");
            mark.hidden = !(at >= 0 && at <= chart.over.clientWidth + 1);
            mark.style.left = `${at}px`;
        };
    }
    return chart;
}

/* The charts of a table, each with a menu of its columns. */
async function tableCharts(parent, data, seek) {
    const x = await unpacked(data.time), all = await unpacked(data.values), names = Object.keys(data.columns);
    const [, lines, samples] = data.values.shape, charts = [];
    const valuesOf = (column, line) => all.subarray((names.indexOf(column) * lines + line) * samples).subarray(0, samples);
    for (const [number, first] of data.first.entries()) {
        const place = document.createElement("div"), menu = document.createElement("select");
        menu.setAttribute("aria-label", `${data.title}: column of chart ${number + 1}`);
        menu.append(...names.map(name => new Option(data.columns[name], name, false, name === first)));
        place.append(menu);
        parent.append(place);
        const show = () => {
            charts[number]?.destroy();
            place.querySelector(".chart")?.remove();
            charts[number] = lineChart(place, { x, unit: data.unit, axis: data.columns[menu.value], seek,
                lines: data.lines.map((label, line) => ({ label, values: valuesOf(menu.value, line) })) });
            player?.draw();  // marks its time
        };
        menu.addEventListener("change", show);
        show();
    }
    return time => charts.forEach(chart => chart.mark?.(time));
}

/* Energies, and their error, against time. */
async function ledgerCharts(parent, data, seek) {
    const x = await unpacked(data.time), all = await unpacked(data.values), samples = x.length;
    const lines = data.lines.map((label, k) => ({ label, values: all.subarray(k * samples, (k + 1) * samples) }));
    const made = [lineChart(parent, { x, unit: data.unit, axis: `energy [${data.energy}]`, lines, seek }),
                  lineChart(parent, { x, unit: data.unit, axis: "energy error [%]", seek,
                                      lines: [{ label: "energy error, of the largest entry", values: await unpacked(data.error) }] })];
    return time => made.forEach(chart => chart.mark(time));
}

/* Traction over places, in the interval of the frame that is shown. */
async function tractionChart(parent, data) {
    const x = await unpacked(data.x), all = await unpacked(data.values), [since, until] =
        [await unpacked(data.since), await unpacked(data.until)], [, kinds, places] = data.values.shape;
    const title = document.createElement("h3"), place = document.createElement("div");
    place.append(title);
    parent.append(place);
    const of = frame => data.lines.map((_, k) => all.subarray((frame * kinds + k) * places).subarray(0, places));
    const chart = lineChart(place, { x, unit: "µm", along: "x", axis: "traction [Pa]", limit: data.usual, height: 260,
                                      lines: data.lines.map((label, k) => ({ label, values: of(0)[k] })) });
    return (frame, unit) => {
        if (!(frame < since.length)) return;
        title.textContent = `Mean from ${shown(since[frame])} to ${shown(until[frame])} ${unit}: normal > 0 pulls the substrate up`;
        chart.setData([Array.from(x), ...of(frame).map(values => Array.from(values))]);
    };
}
