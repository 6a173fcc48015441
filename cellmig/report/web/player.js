/* Plays the frames of a run: cells filled with a field, outlines, arrows, tracks; values of what is pointed at. */
"use strict";

const SECONDS = 12;  // that all frames take
const FAR = 2;  // way of the cells, over their extent at any time, beyond which they would be specks: they are followed
const SAMPLED = 40000;  // values from which the range of colours is taken
const byId = id => document.getElementById(id);

class Player {
    constructor(movie, tracks) {
        Object.assign(this, { movie, tracks, frame: 0, playing: false, cache: new Map(), listeners: [] });
        this.canvas = byId("stage");
        this.context = this.canvas.getContext("2d");
        this.raster = new Raster(movie.colours);
    }

    static async of(movie, trackData) {
        const tracks = trackData && { time: await unpacked(trackData.time), shape: trackData.x.shape,
                                      x: await unpacked(trackData.x) };
        const player = new Player(movie, tracks);
        await player.read();
        return player;
    }

    /* Arrays that every frame needs. */
    async read() {
        const m = this.movie;
        this.x = await Promise.all(m.x.map(unrounded));  // by axis and frame
        this.start = await Promise.all(m.start.map(unpacked));
        [this.triangles, this.borders, this.ids, this.cell, this.material] =
            await Promise.all([m.triangles, m.borders, m.ids, m.cell, m.material].map(unpacked));
        this.surfaces = m.surfaces && await Promise.all(m.surfaces.map(unpacked));  // where triangles change
        this.behind = m.behind && await unrounded(m.behind.values);
        const n = this.ids.length;
        this.on = { x: new Float32Array(n), y: new Float32Array(n), z: new Float32Array(n) };
        this.light = m.dimension === 3 ? new Float32Array(n) : null;
        this.ends = this.x.map(frames => frames.map(values => [least(values), -least(values.map(v => -v))]));
        this.whole = this.corners();
        this.size = this.ends.map(axis => Math.max(...axis.map(([low, high]) => high - low)));
        const ways = this.ends.map(axis => Math.max(...axis.map(end => end[1])) - Math.min(...axis.map(end => end[0])));
        this.far = Math.max(...ways) > FAR * Math.max(...this.size);
        this.view = new View(m.dimension, ...this.whole);
    }

    /* What is shown: all of the scene, or where the cells are. */
    box() {
        if (!this.far || !this.options.follow) return this.whole;
        const [low, high] = this.whole.map(corner => corner.slice()), last = low.length - 1;
        this.ends.forEach((axis, k) => {
            const [least, most] = axis[this.frame], half = 0.55 * this.size[k];
            if (k < last) [low[k], high[k]] = [(least + most) / 2 - half, (least + most) / 2 + half];
        });
        if (this.behind && last === 1) high[1] = Math.min(high[1], 2 * Math.max(...this.ends[1].map(end => end[1])));
        return [low, high];
    }

    corners() {
        const low = this.ends.map(axis => Math.min(...axis.map(end => end[0])));
        const high = this.ends.map(axis => Math.max(...axis.map(end => end[1])));
        if (this.movie.substrate) low[low.length - 1] = Math.min(0, low.at(-1)) - (this.movie.dimension === 2 ? 0.04 * high.at(-1) : 0);
        if (this.behind && this.movie.dimension === 2) {
            low[0] = this.movie.behind.low[0];
            [high[0], high[1]] = this.movie.behind.high;
        }
        return [low, high];
    }

    get times() { return this.movie.times; }
    get time() { return this.times[this.frame]; }

    /* ------------------------------------------------------------------------------------------------- fields */

    /* All fields that can be shown: those of the frames, and the displacement. */
    get fields() {
        const parts = ["x", "y", "z"].slice(0, this.movie.dimension);
        return { ...this.movie.fields, displacement: { label: "displacement", unit: "µm", parts,
                                                       meaning: "from the position at the start" } };
    }

    /* Parts of a field that are offered: a vector has a magnitude, too. */
    partsOf(name) {
        const { parts } = this.fields[name];
        return isVector(parts) ? ["magnitude", ...parts] : parts;
    }

    /* Values of a part of a field in all frames. */
    async values(name, part) {
        const key = `${name}/${part}`;
        if (!this.cache.has(key)) this.cache.set(key, this.make(name, part));
        return this.cache.get(key);
    }

    async make(name, part) {
        const { parts } = this.fields[name];
        if (part === "magnitude") {
            const all = await Promise.all(parts.map(one => this.values(name, one)));
            return all[0].map((_, f) => all[0][f].map((__, i) => Math.hypot(...all.map(one => one[f][i]))));
        }
        const at = parts.indexOf(part);
        if (name === "displacement")
            return this.x[at].map(values => values.map((value, i) => value - this.start[at][i]));
        return unrounded(this.movie.values[name][at]);
    }

    async choose(name, part) {
        const values = await this.values(name, part);
        const every = Math.max(1, Math.floor(values.length * values[0].length / SAMPLED)), some = [];
        for (let k = 0, n = values[0].length; k < values.length * n; k += every) {
            const value = values[Math.floor(k / n)][k % n];
            if (Number.isFinite(value)) some.push(value);
        }
        some.sort((a, b) => a - b);
        let [low, high] = [0.01, 0.99].map(share => some[Math.round(share * (some.length - 1))] ?? 0);
        if (!(high > low)) [low, high] = [some[0] ?? 0, some.at(-1) ?? 1];
        if (!(high > low)) [low, high] = [low - 0.5, low + 0.5];
        Object.assign(this, { name, part, low, high, shownValues: values, beyond: [some[0] < low, some.at(-1) > high] });
        this.draw();
    }

    get range() { return { low: this.low, high: this.high, beyond: this.beyond, colours: this.movie.colours }; }

    get label() {
        const { label, unit } = this.fields[this.name];
        return `${label}${this.part ? `, ${this.part}` : ""}${unit ? ` [${unit}]` : ""}`;
    }

    async arrowsOf(name) {
        this.arrows = name && await Promise.all(this.fields[name].parts.map(part => this.values(name, part)));
        this.longest = 0;
        for (const frame of this.arrows ? this.times.keys() : [])
            for (let i = 0; i < this.ids.length; i++)
                this.longest = Math.max(this.longest, Math.hypot(...this.arrows.map(a => a[frame][i] || 0)));
        this.arrowName = name;
        this.draw();
    }

    /* ------------------------------------------------------------------------------------------------ drawing */

    resize() {
        this.view.show(this.box());
        const { dimension } = this.movie, { low, high } = this.view, width = this.canvas.clientWidth;
        if (!width) return;  // not in sight, as in a part of another page that is folded
        const share = dimension === 2 ? (high[1] - low[1]) / (high[0] - low[0] || 1) : 0.5;
        const height = Math.round(Math.min(560, Math.max(220, share * (width - 56) + 40)));
        this.canvas.style.height = `${height}px`;
        this.ratio = Math.min(2, window.devicePixelRatio || 1);
        const size = { width: Math.round(width * this.ratio), height: Math.round(height * this.ratio) };
        if (size.width !== this.canvas.width || size.height !== this.canvas.height) Object.assign(this.canvas, size);
        this.raster.resize(size.width, size.height);
        this.view.resize(width, height);
        this.paint();  // now: a new size has emptied the canvas
    }

    /* Draw soon, once, however often it is asked for. */
    draw() {
        if (this.due) return;
        this.due = requestAnimationFrame(() => { this.due = 0; this.paint(); });
    }

    paint() {
        if (!this.shownValues || !this.ratio) return;
        const { context: g, view, raster, options } = this, x = this.x.map(frames => frames[this.frame]);
        const values = this.shownValues[this.frame], scaled = this.scaled ??= new Float32Array(values.length);
        for (let i = 0; i < values.length; i++) scaled[i] = (values[i] - this.low) / (this.high - this.low);
        view.show(this.box());
        view.project(x, this.ratio, this.on);
        const triangles = this.surfaces ? this.surfaces[this.movie.surface[this.frame]] : this.triangles;
        if (this.light) shine(this.light, x, triangles, view);
        raster.fill(triangles, this.on.x, this.on.y, this.on.z, scaled, this.light, options.levels);
        g.setTransform(1, 0, 0, 1, 0, 0);
        g.fillStyle = "#fff";
        g.fillRect(0, 0, this.canvas.width, this.canvas.height);
        g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
        const behind = this.behind && options.behind, flat = view.dimension === 2, below = view.elevation < 0;
        if (behind && flat) this.paintBehind(g);
        drawGround(g, view, this.movie.substrate);
        if (behind && !flat && !below) this.paintTraction(g);
        g.drawImage(raster.canvas, 0, 0, view.width, view.height);
        if (behind && !flat && below) this.paintTraction(g);  // seen through the substrate, as by a microscope
        g.setTransform(1, 0, 0, 1, 0, 0);
        if (options.outlines && flat) drawOutlines(g, this.on, this.movie.loops, this.borders, this.ratio);
        g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
        if (options.tracks && this.tracks) this.paintTracks(g);
        if (this.arrows && this.longest) this.paintArrows(g, x);
        drawAxes(g, view);
        this.listeners.forEach(tell => tell(this));
    }

    paintBehind(g) {
        const { low, high, counts } = this.movie.behind, values = this.behind[Math.min(this.frame, this.behind.length - 1)];
        const small = document.createElement("canvas");
        [small.width, small.height] = counts;
        const image = small.getContext("2d").createImageData(...counts);
        const all = this.behindRange ??= [Math.min(...this.behind.map(least)), Math.max(...this.behind.map(v => -least(v.map(w => -w))))];
        values.forEach((value, k) => {
            const at = 4 * ((counts[1] - 1 - Math.floor(k / counts[0])) * counts[0] + k % counts[0]);
            const share = (value - all[0]) / (all[1] - all[0] || 1);
            image.data.set([255 - 12 * share, 255 - 70 * share, 255 - 117 * share, Number.isFinite(value) ? 255 : 0], at);
        });
        small.getContext("2d").putImageData(image, 0, 0);
        const [x0, y0] = this.view.at([low[0], high[1]]), [x1, y1] = this.view.at([high[0], low[1]]);
        g.drawImage(small, x0, y0, x1 - x0, y1 - y0);
    }

    /* Squares of the substrate in three dimensions: orange where it is pulled up, violet where it is pressed. */
    paintTraction(g) {
        const { low, width, counts, usual } = this.movie.behind;
        const corner = (i, j) => this.view.at([low[0] + width * i, low[1] + width * j, 0]);
        this.behind[this.frame].forEach((value, k) => {
            const share = Math.min(1, Math.abs(value) / usual), [i, j] = [Math.floor(k / counts[1]), k % counts[1]];
            if (share < 0.02) return;
            g.fillStyle = value > 0 ? `rgb(224 130 20 / ${share})` : `rgb(84 39 136 / ${share})`;
            g.beginPath();
            g.moveTo(...corner(i, j));
            for (const at of [[i + 1, j], [i + 1, j + 1], [i, j + 1]]) g.lineTo(...corner(...at));
            g.fill();
        });
    }

    paintTracks(g) {
        const { time, shape: [cells, samples, d], x } = this.tracks;
        g.lineWidth = 1.6;
        for (let cell = 0; cell < cells; cell++) {
            let last = null;
            g.beginPath();
            for (let s = 0; s < samples && time[s] <= this.time * (1 + 1e-6); s++) {
                const from = (cell * samples + s) * d;
                last = this.view.at(Array.from(x.subarray(from, from + d)));
                if (s) g.lineTo(...last); else g.moveTo(...last);
            }
            g.strokeStyle = "#fff"; g.lineWidth = 3.4; g.stroke();
            g.strokeStyle = "#d1246b"; g.lineWidth = 1.6; g.stroke();
            if (!last) continue;
            g.beginPath();
            g.arc(...last, 2.6, 0, 7);
            g.fillStyle = "#d1246b"; g.fill();
        }
    }

    paintArrows(g, x) {
        const length = Math.max(24, 0.09 * Math.min(this.view.width, 900)), [right, up] = this.view.axes();
        g.strokeStyle = g.fillStyle = "#000";
        g.lineWidth = 1.1;
        const arrows = this.arrows.map(part => part[this.frame]);
        for (let i = 0; i < this.ids.length; i++) {
            const f = arrows.map(part => part[i]), size = Math.hypot(...f);
            if (!(size > 0.02 * this.longest) || this.hidden(i)) continue;
            const [ax, ay] = [this.on.x[i] / this.ratio, this.on.y[i] / this.ratio];
            drawArrow(g, ax, ay, ax + dot(right, f) / this.longest * length, ay - dot(up, f) / this.longest * length);
        }
        const { label, unit } = this.fields[this.arrowName], text = `${label} ${shown(this.longest, 3)} ${unit}`;
        g.font = "12px system-ui, sans-serif";
        const y = 16, left = this.view.width - g.measureText(text).width - 14;
        g.fillText(text, left, y + 4);
        drawArrow(g, left - length - 8, y, left - 8, y);
    }

    /* Whether a particle in three dimensions is behind something. */
    hidden(i) {
        if (this.movie.dimension === 2) return false;
        const column = Math.round(this.on.x[i]), row = Math.round(this.on.y[i]);
        if (column < 0 || row < 0 || column >= this.canvas.width || row >= this.canvas.height) return true;
        return this.raster.depth[row * this.canvas.width + column] > this.on.z[i] + 0.05 * (this.view.high[0] - this.view.low[0]);
    }

    /* ------------------------------------------------------------------------------------------------- values */

    /* The particle nearest to a point of the picture [CSS pixels], -1 if none is near. */
    nearest(px, py) {
        let found = -1, best = (16 * this.ratio) ** 2;
        for (let i = 0; i < this.ids.length; i++) {
            const far = (this.on.x[i] - px * this.ratio) ** 2 + (this.on.y[i] - py * this.ratio) ** 2;
            if (far < best && !this.hidden(i)) [found, best] = [i, far];
        }
        return found;
    }

    /* Rows of name and text about a particle in the frame. */
    async about(i) {
        const rows = [["at", this.x.map(axis => shown(axis[this.frame][i])).join(", ") + " µm"]];
        for (const [name, { label, unit, parts }] of Object.entries(this.fields)) {
            const values = await Promise.all(parts.map(part => this.values(name, part)));
            const texts = values.map((one, k) => (parts.length > 2 && !isVector(parts) ? `${parts[k]} ` : "") + shown(one[this.frame][i]));
            rows.push([label, `${texts.join(", ")} ${unit}`]);
        }
        return rows;
    }

    seek(frame) {
        this.frame = Math.min(this.times.length - 1, Math.max(0, frame));
        this.draw();
    }

    /* To the frame nearest to a time. */
    seekTime(time) {
        const away = this.times.map(one => Math.abs(one - time));
        this.seek(away.indexOf(Math.min(...away)));
    }

    play(on = !this.playing) {
        this.playing = on && this.times.length > 1;
        if (this.playing) {
            const first = this.frame === this.times.length - 1 ? 0 : this.frame, begun = performance.now();
            const each = Math.max(40, Math.min(250, 1000 * SECONDS / this.times.length));
            const next = now => {
                if (!this.playing) return;
                const frame = first + Math.floor(Math.max(0, now - begun) / each);
                if (frame !== this.frame) this.seek(frame);
                if (frame >= this.times.length - 1) this.play(false); else requestAnimationFrame(next);
            };
            requestAnimationFrame(next);
        }
        this.draw();
    }
}

const isVector = parts => parts.length > 1 && parts[0] === "x";
