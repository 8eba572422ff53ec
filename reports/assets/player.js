// The scene player: plan as dashed outline, replay filled, contact forces as bars; the data stand in a JSON element beside it.
(() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  // A box reaches little more than half its longer side, a line or a wall of one length half of that, a disc its radius.
  const isLine = (shape) => shape.size.length === 1 && (shape.kind === "line" || shape.kind === "wall");
  const reach = (shape) => Math.max(...shape.size) * (shape.kind === "box" ? 0.75 : isLine(shape) ? 0.5 : 1);

  const start = (player) => {
    const data = JSON.parse(player.querySelector("script").textContent);
    const canvas = player.querySelector("canvas");
    const slider = player.querySelector("input");
    const button = player.querySelector("button");
    const output = player.querySelector("output");
    const pen = canvas.getContext("2d");
    const last = data.t.length - 1;
    const tracks = [data.plan, data.replay].filter(Boolean);
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const track of tracks) {
      track.forEach((poses, which) => {
        const far = reach(data.shapes[which]);
        for (const [x, y] of poses || []) {
          left = Math.min(left, x - far); right = Math.max(right, x + far);
          low = Math.min(low, y - far); high = Math.max(high, y + far);
        }
      });
    }
    if (!(right > left)) return;
    const forces = [...(data.plan_force || []), ...(data.replay_force || [])].filter(Boolean);
    const strongest = Math.max(1e-9, ...forces.map((list) => Math.max(...list)));
    const bars = data.contacts.length * 34 + 16;
    const room = { width: 880, height: 0 };
    const sharp = Math.min(2, window.devicePixelRatio || 1);
    let scale = 1;
    const measure = () => {
      room.width = Math.min(880, Math.max(300, canvas.clientWidth));
      scale = Math.min((room.width - 24) / (right - left), 300 / (high - low));
      room.height = Math.ceil((high - low) * scale + 24 + bars);
      canvas.width = room.width * sharp;
      canvas.height = room.height * sharp;
    };
    const place = (x, y) => [(x - (left + right) / 2) * scale + room.width / 2, 12 + (high - y) * scale];

    const body = (shape, [x, y, angle], filled) => {
      const [px, py] = place(x, y);
      pen.save();
      pen.translate(px, py);
      pen.rotate(-angle);
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
        pen.moveTo(0, 0);
        pen.lineTo(shape.size[0] * scale, 0);
      }
      pen.lineWidth = 2;
      if (filled) {
        pen.fillStyle = colour("--touch");
        pen.strokeStyle = colour("--replay");
        pen.fill();
      } else {
        pen.strokeStyle = colour("--plan");
        pen.setLineDash([6, 4]);
      }
      pen.stroke();
      pen.restore();
      if (filled || !data.replay) {
        pen.fillStyle = colour("--ink");
        pen.textAlign = "center";
        pen.fillText(shape.name, px, py + 5);
      }
    };
    const bar = (which, frame) => {
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
        pen.fillRect(from, top + below, Math.max(1, (values[frame] / strongest) * full), 10);
      });
      const values = (data.replay_force && data.replay_force[which]) || (data.plan_force && data.plan_force[which]);
      pen.fillStyle = colour("--ink");
      if (values) pen.fillText(`${values[frame].toFixed(2)} N`, room.width - 72, top + 17);
    };
    let frame = 0;
    const draw = () => {
      pen.setTransform(sharp, 0, 0, sharp, 0, 0);
      pen.clearRect(0, 0, room.width, room.height);
      pen.font = room.width < 500 ? "12px system-ui, sans-serif" : "15px system-ui, sans-serif";
      data.shapes.forEach((shape, which) => { if (data.replay && data.replay[which]) body(shape, data.replay[which][frame], true); });
      data.shapes.forEach((shape, which) => { if (data.plan && data.plan[which]) body(shape, data.plan[which][frame], false); });
      data.contacts.forEach((_, which) => bar(which, frame));
      output.textContent = `${data.t[frame].toFixed(2)} s`;
      slider.value = frame;
      slider.setAttribute("aria-valuetext", `${data.t[frame].toFixed(2)} seconds`);
    };
    let began = null;
    const stop = () => {
      began = null;
      button.textContent = "▶";
      button.setAttribute("aria-label", "Play");
    };
    const tick = (now) => {
      if (began === null) return;
      const t = data.t[0] + (now - began) / 1000;
      while (frame < last && data.t[frame + 1] <= t) frame += 1;
      draw();
      if (frame >= last) stop(); else requestAnimationFrame(tick);
    };
    const play = () => {
      if (began !== null) { stop(); return; }
      if (frame >= last) frame = 0;
      began = performance.now() - (data.t[frame] - data.t[0]) * 1000;
      button.textContent = "❚❚";
      button.setAttribute("aria-label", "Stop");
      requestAnimationFrame(tick);
    };
    slider.max = last;
    slider.addEventListener("input", () => { stop(); frame = Number(slider.value); draw(); });
    slider.addEventListener("keydown", (event) => { if (event.key === " ") { event.preventDefault(); play(); } });
    button.addEventListener("click", play);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    new ResizeObserver(() => { measure(); draw(); }).observe(canvas.parentElement);
    measure();
    draw();
  };
  document.querySelectorAll("[data-player]").forEach((player) => {
    player.hidden = false;
    start(player);
  });
})();
