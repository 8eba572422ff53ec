// The scene player: plan dashed, replay filled, goal dotted, contact forces as arrows and bars; data in a JSON element.
(() => {
  // Longest and shortest drawn arrow [pixel].
  const [ARROW, SEEN] = [64, 1.5];
  // A first value, then changes, in grains; a single number is constant.
  const sums = (steps, grain, frames) => {
    let at = 0;
    return Array.from({ length: frames }, (_, frame) => (at += steps[frame] || 0) * grain);
  };
  const unpacked = (data) => {
    const [begin, end, frames] = data.t;
    const poses = (track) => track && track.map((axes) => {
      if (!axes) return null;
      const [x, y, angle] = axes.map((steps, axis) => sums(steps, data.grain[axis], frames));
      return Object.assign(x.map((value, frame) => [value, y[frame], angle[frame]]), { axes: [x, y, angle] });
    });
    const forces = (lists) => lists && lists.map((steps) => steps && sums(steps, data.push, frames));
    return {
      ...data, t: Array.from({ length: frames }, (_, frame) => begin + ((end - begin) * frame) / (frames - 1)),
      plan: poses(data.plan), replay: poses(data.replay), plan_force: forces(data.plan_force), replay_force: forces(data.replay_force),
    };
  };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  // Largest extent: of a box about 0.75 of its longer side, of a line or wall half its length, of a disc its radius.
  const isLine = (shape) => shape.size.length === 1 && (shape.kind === "line" || shape.kind === "wall");
  const reach = (shape) => Math.max(...shape.size) * (shape.kind === "box" ? 0.75 : isLine(shape) ? 0.5 : 1);

  const start = (player) => {
    const data = unpacked(JSON.parse(player.querySelector("script").textContent));
    const canvas = player.querySelector("canvas");
    const slider = player.querySelector("input");
    const button = player.querySelector("button");
    const output = player.querySelector("output");
    const choice = Object.fromEntries([...player.querySelectorAll("[name]")].map((input) => [input.name, input]));
    const shows = (name) => choice[name].checked;
    const pen = canvas.getContext("2d");
    const last = data.t.length - 1;
    const goals = data.shapes.map((shape) => shape.goal && [shape.goal]);
    const tracks = [data.plan, data.replay, goals].filter(Boolean);
    // Options without content are hidden.
    for (const [name, there] of [["plan", data.plan], ["replay", data.replay], ["goal", goals.some(Boolean)], ["forces", data.contacts.length]]) {
      choice[name].parentElement.hidden = !there;
    }
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const track of tracks) {
      track.forEach((poses, which) => {
        const far = reach(data.shapes[which]);
        for (const [x, y, angle] of poses || []) {
          const [wide, tall] = isLine(data.shapes[which]) ? [far * Math.abs(Math.cos(angle)), far * Math.abs(Math.sin(angle))] : [far, far];
          left = Math.min(left, x - wide); right = Math.max(right, x + wide);
          low = Math.min(low, y - tall); high = Math.max(high, y + tall);
        }
      });
    }
    if (!(right > left)) return;
    const forces = [...(data.plan_force || []), ...(data.replay_force || [])].filter(Boolean);
    const strongest = Math.max(1e-9, ...forces.map((list) => Math.max(...list)));
    const bars = data.contacts.length * 34 + 16;
    const room = { width: 880, height: 0, top: 12 };
    const sharp = Math.min(2, window.devicePixelRatio || 1);
    let scale = 1;
    // Shown time in frames, interpolated for smooth slow motion.
    let frame = 0;
    const at = (values) => {
      const low = Math.floor(frame);
      return low >= last ? values[last] : values[low] + (frame - low) * (values[low + 1] - values[low]);
    };
    const pose = (track, which) => track && track[which] && [0, 1, 2].map((axis) => at(track[which].axes[axis]));
    const now = () => at(data.t);
    const measure = () => {
      room.width = Math.min(880, Math.max(300, canvas.clientWidth));
      // Tall scenes get more height.
      scale = Math.min((room.width - 24) / (right - left), (high - low > right - left ? 400 : 300) / (high - low));
      // Flat scenes get room for the names of bodies.
      const area = Math.max((high - low) * scale + 24, 17 * Math.min(data.shapes.length + 2, 9));
      room.top = (area - (high - low) * scale) / 2;
      room.height = Math.ceil(area + bars);
      canvas.width = room.width * sharp;
      canvas.height = room.height * sharp;
    };
    const place = (x, y) => [(x - (left + right) / 2) * scale + room.width / 2, room.top + (high - y) * scale];

    const body = (shape, [x, y, angle], manner) => {
      const [px, py] = place(x, y);
      pen.save();
      pen.translate(px, py);
      pen.rotate(-(angle || 0));
      pen.beginPath();
      if (isLine(shape)) {
        const long = shape.size[0] * scale;
        pen.moveTo(-long / 2, 0);
        pen.lineTo(long / 2, 0);
      } else if (shape.kind === "box" || shape.size.length > 1) {
        const [wide, tall] = [shape.size[0] * scale, (shape.size[1] || shape.size[0]) * scale];
        pen.rect(-wide / 2, -tall / 2, wide, tall);
      } else {
        pen.arc(0, 0, shape.size[0] * scale, 0, 2 * Math.PI);
        // A free angle of a goal is not drawn.
        if (angle !== null) pen.moveTo(0, 0);
        if (angle !== null) pen.lineTo(shape.size[0] * scale, 0);
      }
      pen.lineWidth = 2;
      if (manner === "goal") {
        pen.strokeStyle = colour("--level");
        pen.setLineDash([2, 3]);
      } else if (manner === "replay") {
        pen.fillStyle = colour("--touch");
        pen.strokeStyle = colour("--replay");
        pen.fill();
      } else {
        pen.strokeStyle = colour("--plan");
        pen.setLineDash([6, 4]);
      }
      pen.stroke();
      pen.restore();
    };
    // Width and height of a shape through its centre [pixel].
    const chords = (shape, angle) => {
      if (isLine(shape)) return [0, 0];
      const [wide, tall] = shape.kind === "box" ? [shape.size[0], shape.size[1] || shape.size[0]] : [2 * shape.size[0], 2 * shape.size[0]];
      if (shape.kind !== "box") return [wide * scale, tall * scale];
      const [along, across] = [Math.max(Math.abs(Math.cos(angle)), 1e-9), Math.max(Math.abs(Math.sin(angle)), 1e-9)];
      return [Math.min(wide / along, tall / across) * scale, Math.min(tall / along, wide / across) * scale];
    };
    // Names are inside a body with room, else beside it without overlap; larger bodies first.
    const names = () => {
      const tall = room.width < 500 ? 14 : 17;
      const taken = [];
      const found = data.shapes.map((shape, which) => [shape, pose(shows("replay") && data.replay, which) || pose(shows("plan") && data.plan, which)]);
      for (const [shape, where] of found.filter((one) => one[1]).sort((one, other) => reach(other[0]) - reach(one[0]))) {
        const [px, py] = place(where[0], where[1]);
        const long = pen.measureText(shape.name).width;
        const [wide, high] = chords(shape, where[2]);
        const [aside, away] = [wide / 2 + long / 2 + 6, high / 2 + tall / 2 + 2];
        const spots = wide > long + 6 && high > tall ? [[0, 0]] : [];
        if (isLine(shape)) {
          // Beside the line, perpendicular.
          const [right, up] = [-Math.sin(where[2]), Math.cos(where[2])];
          const far = Math.abs(right) * (long / 2) + Math.abs(up) * (tall / 2) + 4;
          spots.push([right * far, -up * far], [-right * far, up * far]);
        }
        spots.push([aside, 0], [-aside, 0]);
        for (const row of [0, 1, 2, 3]) spots.push([0, -away - row * tall], [0, away + row * tall], [aside, -row * tall], [-aside, -row * tall], [aside, row * tall], [-aside, row * tall]);
        const free = ([x, y]) => px + x - long / 2 >= 2 && px + x + long / 2 <= room.width - 2 && py + y > tall / 2 && py + y < room.height - bars
          && !taken.some(([left, upper, width]) => Math.abs(px + x - left) < (long + width) / 2 + 3 && Math.abs(py + y - upper) < tall);
        const spot = spots.find(free);
        if (!spot) continue;
        taken.push([px + spot[0], py + spot[1], long]);
        pen.textAlign = "center";
        pen.lineWidth = 4;
        pen.lineJoin = "round";
        pen.setLineDash([]);
        pen.strokeStyle = colour(spot[0] || spot[1] ? "--card" : "--touch");
        pen.strokeText(shape.name, px + spot[0], py + spot[1] + tall * 0.3);
        pen.fillStyle = colour("--ink");
        pen.fillText(shape.name, px + spot[0], py + spot[1] + tall * 0.3);
      }
    };
    // A shape's point [m]: its centre or the end of a line.
    const point = (which, end, [x, y, angle]) => {
      const long = end * data.shapes[which].size[0];
      return [x + long * Math.cos(angle), y + long * Math.sin(angle)];
    };
    // Distance of the surface from that point: a radius, or half a side.
    const surface = (which, end, angle, [dx, dy]) => {
      const { kind, size } = data.shapes[which];
      if (end || kind === "line" || kind === "wall") return 0;
      if (kind !== "box") return size[0];
      const along = Math.abs(dx * Math.cos(angle) + dy * Math.sin(angle));
      const across = Math.abs(dy * Math.cos(angle) - dx * Math.sin(angle));
      return Math.min(size[0] / 2 / Math.max(along, 1e-9), (size[1] || size[0]) / 2 / Math.max(across, 1e-9));
    };
    const arrow = (from, [dx, dy], long, wide, ink) => {
      const [x, y] = place(...from);
      const [tx, ty] = [x + dx * long, y - dy * long];
      const head = Math.min(8, long * 0.6);
      pen.strokeStyle = pen.fillStyle = ink;
      pen.lineWidth = wide;
      pen.setLineDash([]);
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(tx - dx * head * 0.8, ty + dy * head * 0.8);
      pen.stroke();
      pen.beginPath();
      pen.moveTo(tx, ty);
      pen.lineTo(tx - dx * head - dy * head * 0.55, ty + dy * head - dx * head * 0.55);
      pen.lineTo(tx - dx * head + dy * head * 0.55, ty + dy * head + dx * head * 0.55);
      pen.fill();
    };
    // The two arrows of a contact, pushing the bodies apart.
    const push = (which, track, forces, name, wide) => {
      const touch = data.touches[which];
      const values = forces && forces[which];
      if (!touch || !values || !track) return;
      const long = (at(values) / strongest) * ARROW;
      const [one, other] = touch.shapes;
      if (!(Math.abs(long) > SEEN) || !track[one] || !track[other]) return;
      const [first, second] = [pose(track, one), pose(track, other)];
      const [a, b] = [point(one, touch.ends[0], first), point(other, touch.ends[1], second)];
      let normal;
      if (touch.turn !== null) {
        normal = [Math.cos(second[2] + touch.turn), Math.sin(second[2] + touch.turn)];
      } else {
        const far = Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
        normal = [(a[0] - b[0]) / far, (a[1] - b[1]) / far];
      }
      const deep = surface(one, touch.ends[0], first[2], normal);
      const spot = [a[0] - normal[0] * deep, a[1] - normal[1] * deep];
      const size = Math.abs(long);
      const to = long > 0 ? normal : [-normal[0], -normal[1]];
      arrow(spot, to, size, wide, colour(name));
      arrow(spot, [-to[0], -to[1]], size, wide, colour(name));
    };
    const bar = (which) => {
      const top = room.height - bars + 8 + which * 34;
      const from = Math.min(150, room.width * 0.3);
      const full = room.width - from - 90;
      pen.textAlign = "left";
      pen.fillStyle = colour("--soft");
      pen.fillText(`force ${data.contacts[which]}`, 16, top + 17);
      [["--plan", data.plan_force, 0], ["--replay", data.replay_force, 13]].forEach(([name, list, below]) => {
        const values = list && list[which];
        if (!values) return;
        pen.fillStyle = colour(name);
        pen.fillRect(from, top + below, Math.max(1, (at(values) / strongest) * full), 10);
      });
      const values = (data.replay_force && data.replay_force[which]) || (data.plan_force && data.plan_force[which]);
      pen.fillStyle = colour("--ink");
      if (values) pen.fillText(`${at(values).toFixed(2)} N`, room.width - 72, top + 17);
    };
    const draw = () => {
      pen.setTransform(sharp, 0, 0, sharp, 0, 0);
      pen.clearRect(0, 0, room.width, room.height);
      pen.font = room.width < 500 ? "12px system-ui, sans-serif" : "15px system-ui, sans-serif";
      for (const [name, track] of [["replay", data.replay], ["plan", data.plan]]) {
        data.shapes.forEach((shape, which) => { if (shows(name) && track && track[which]) body(shape, pose(track, which), name); });
      }
      data.shapes.forEach((shape) => { if (shows("goal") && shape.goal) body(shape, shape.goal, "goal"); });
      data.contacts.forEach((_, which) => {
        // The plan's arrow is broad and below, a rim if both agree.
        if (shows("forces") && shows("plan")) push(which, data.plan, data.plan_force, "--plan", 6);
        if (shows("forces") && shows("replay")) push(which, data.replay, data.replay_force, "--push", 2.5);
        bar(which);
      });
      if (shows("labels")) names();
      output.textContent = `${now().toFixed(2)} of ${data.t[last].toFixed(2)} s`;
      slider.value = Math.round(frame);
      slider.setAttribute("aria-valuetext", `${now().toFixed(2)} seconds`);
    };
    // With reduced motion two frames per second.
    const calm = matchMedia("(prefers-reduced-motion: reduce)");
    const CALM = 500;
    let before = null;
    let drawn = 0;
    const stop = () => {
      before = null;
      button.textContent = "▶";
      button.setAttribute("aria-label", "Play");
    };
    const tick = (stamp) => {
      if (before === null) return;
      const frames = ((stamp - before) / 1000) * Number(choice.speed.value) / (data.t[1] - data.t[0]);
      before = stamp;
      frame += Math.max(0, frames);
      const ended = frame >= last;
      if (ended) frame = shows("loop") ? 0 : last;
      if (!calm.matches || ended || stamp - drawn > CALM) { draw(); drawn = stamp; }
      if (ended && !shows("loop")) stop(); else requestAnimationFrame(tick);
    };
    const play = () => {
      if (before !== null) { stop(); draw(); return; }
      if (frame >= last) frame = 0;
      before = performance.now();
      button.textContent = "❚❚";
      button.setAttribute("aria-label", "Pause");
      requestAnimationFrame(tick);
    };
    slider.max = last;
    slider.addEventListener("input", () => { stop(); frame = Number(slider.value); draw(); });
    // Keys work everywhere except on controls that use them.
    player.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey || event.target.matches("select, [type=checkbox]")) return;
      if (event.key === " " && event.target !== button) { event.preventDefault(); play(); }
      const whole = Math.round(frame);
      const target = { ArrowRight: whole + 1, ArrowUp: whole + 1, ArrowLeft: whole - 1, ArrowDown: whole - 1, Home: 0, End: last }[event.key];
      if (target === undefined) return;
      event.preventDefault();
      stop();
      frame = Math.min(Math.max(target, 0), last);
      draw();
    });
    canvas.addEventListener("click", () => { slider.focus(); play(); });
    button.addEventListener("click", play);
    player.querySelectorAll("[type=checkbox]").forEach((box) => box.addEventListener("change", draw));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    new ResizeObserver(() => { measure(); draw(); }).observe(canvas.parentElement);
    measure();
    draw();
  };
  const near = new IntersectionObserver((entries) => {
    entries.filter((entry) => entry.isIntersecting).forEach((entry) => { near.unobserve(entry.target); start(entry.target); });
  });
  // Players in closed elements start when visible; a page may have hundreds.
  document.querySelectorAll("[data-player][hidden]").forEach((player) => {
    player.hidden = false;
    if (player.closest("details:not([open])")) near.observe(player); else start(player);
  });
})();
