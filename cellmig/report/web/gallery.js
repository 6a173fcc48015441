/* The last frames of many runs beside each other, filled with a field in the same colours. */
"use strict";

async function showStills(parent, { low, high, label, unit, colours, beyond, runs }) {
    const bar = document.createElement("canvas"), gallery = document.createElement("div");
    bar.className = "bar-of-all";
    gallery.className = "gallery small";
    parent.append(gallery, bar);
    const paintBar = () => drawBar(bar, { low, high, beyond, colours, label: `${label} [${unit}]` });
    new ResizeObserver(paintBar).observe(bar);
    for (const run of runs) {
        const figure = document.createElement("figure"), canvas = document.createElement("canvas");
        const caption = document.createElement("figcaption"), still = await Still.of(run, colours, low, high);
        caption.textContent = `${run.name} at ${shown(run.time)} ${run.unit}: ${label} ${shown(still.mean)} ${unit} in the mean, ` +
            `${shown(still.most)} ${unit} at most`;
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", caption.textContent);
        figure.append(canvas, caption);
        gallery.append(figure);
        new ResizeObserver(() => still.paint(canvas)).observe(canvas);
    }
}

class Still {
    static async of(run, colours, low, high) {
        const still = new Still(), x = await Promise.all(run.x.map(unrounded)), [values] = await unrounded(run.values);
        const [triangles, borders] = await Promise.all([run.triangles, run.borders].map(unpacked));
        const finite = values.filter(Number.isFinite), n = values.length;
        return Object.assign(still, {
            run, triangles, borders, x: x.map(frames => frames[0]), scaled: values.map(value => (value - low) / (high - low)),
            mean: finite.reduce((sum, value) => sum + value, 0) / finite.length, most: -least(finite.map(value => -value)),
            raster: new Raster(colours), light: run.dimension === 3 ? new Float32Array(n) : null,
            on: { x: new Float32Array(n), y: new Float32Array(n), z: new Float32Array(n) } });
    }

    paint(canvas) {
        const ratio = Math.min(2, window.devicePixelRatio || 1), { clientWidth: width, clientHeight: height } = canvas;
        if (!width) return;  // not in sight
        const ends = this.x.map(axis => [least(axis), -least(axis.map(value => -value))]), g = canvas.getContext("2d");
        const view = new View(this.run.dimension, ends.map(end => end[0]), ends.map(end => end[1]));
        Object.assign(canvas, { width: width * ratio, height: height * ratio });
        this.raster.resize(canvas.width, canvas.height);
        view.resize(width, height);
        view.project(this.x, ratio, this.on);
        if (this.light) shine(this.light, this.x, this.triangles, view);
        this.raster.fill(this.triangles, this.on.x, this.on.y, this.on.z, this.scaled, this.light, false);
        g.setTransform(ratio, 0, 0, ratio, 0, 0);
        drawGround(g, view, this.run.substrate);
        g.drawImage(this.raster.canvas, 0, 0, width, height);
        g.setTransform(1, 0, 0, 1, 0, 0);
        if (!this.light) drawOutlines(g, this.on, this.run.loops, this.borders, ratio);
        g.setTransform(ratio, 0, 0, ratio, 0, 0);
        drawAxes(g, view);
    }
}
