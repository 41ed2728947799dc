// The loop over steps and slots. What runs when comes from tables; `BODIES` says what a node does.
//
// A block holds W environments. Its fixed record (environments, schedule rows, parameters, states that never
// change) is read, its moving record (step, states, readings, last outputs) is written.

INLINE i32 seq_at(const Model &m, i64 row, i64 step, i64 slot) {
  const i64 at = (row * (m.steps + 1) + step) * m.slots + slot;
  return m.small_table ? ((const int16_t *)m.table)[at] : ((const i32 *)m.table)[at];
}
INLINE double seconds(i64 ticks, const Model &m) { return double(ticks) / m.resolution; }

template <class V> static void pick_as(const char *ring, i64 bytes, i32 mask, VI cell, unsigned present, i64 count, char *out) {
  for (i64 k = 0; k < count; k++) {
    V r = ld<V>(ring, k);
    for (i32 q = 0; q <= mask; q++)
      if (present >> q & 1) r = sel(eq(cell, splat<VI>(q)), ld<V>(ring + q * bytes, k), r);
    st(out, k, r);
  }
}
// Each lane's own cell of a ring.
static void pick(const char *ring, i64 bytes, i32 mask, const i32 *cell, i64 count, i64 size, char *out) {
  if (mask < 16 && size >= 4) {
    unsigned present = 0;
    for (int l = 0; l < W; l++) present |= 1u << cell[l];
    VI c;
    memcpy(&c, cell, sizeof c);
    if (size == 4) return pick_as<VI>(ring, bytes, mask, c, present, count, out);
    return pick_as<VL>(ring, bytes, mask, c, present, count, out);
  }
  for (i64 k = 0; k < count; k++)
    for (int l = 0; l < W; l++) memcpy(out + (k * W + l) * size, ring + cell[l] * bytes + (k * W + l) * size, size);
}
template <class V> INLINE void blend(char *to, const char *from, i64 count, VB where) {
  for (i64 k = 0; k < count; k++) st(to, k, sel(where, ld<V>(from, k), ld<V>(to, k)));
}
static void blend_bytes(char *to, const char *from, i64 count, i64 size, const i32 *where) {
  for (i64 k = 0; k < count; k++)
    for (int l = 0; l < W; l++)
      if (where[l]) memcpy(to + (k * W + l) * size, from + (k * W + l) * size, size);
}
static void blend_sized(char *to, const char *from, i64 count, i64 size, const i32 *where) {
  VB m;
  memcpy(&m.m, where, sizeof m.m);
  if (size == 4) blend<VI>(to, from, count, m);
  else if (size == 8) blend<VL>(to, from, count, m);
  else blend_bytes(to, from, count, size, where);
}
// Write outputs of steps `seq` (-1: none) into their cells.
static void write(Block &b, const NodeInfo &n, const i32 *seq, const char *value) {
  const i64 bytes = n.count * n.size * W;
  char *ring = b.moving + n.ring;
  if (b.uniform) {
    memcpy(ring + (seq[0] & n.ring_mask) * bytes, value, bytes);
    return;
  }
  for (i32 q = 0; q <= n.ring_mask; q++) {
    i32 where[W];
    bool some = false, all = true;
    for (int l = 0; l < W; l++) {
      const bool here = seq[l] >= 0 && (seq[l] & n.ring_mask) == q;
      where[l] = -here;
      some |= here;
      all &= here;
    }
    if (all) memcpy(ring + q * bytes, value, bytes);
    else if (some) blend_sized(ring + q * bytes, value, n.count, n.size, where);
  }
}

// Times of a message [s]; minus infinity of an initial output.
INLINE void times_of(const Model &m, const EdgeInfo &e, i64 row, i32 message, double &sent, double &received) {
  sent = received = -__builtin_inf();
  if (message < 0) return;
  const i64 step = row * m.step_columns + m.node[e.sender].step_base + message;
  if (e.flags & 2) sent = seconds(m.t_end[step], m);
  if (e.flags & 4) received = seconds(m.t_received[row * m.message_columns + e.message_base + message], m);
}

// Collect what node `n` sees at its step `seq`, the same in all lanes.
static void look_together(const Block &b, const NodeInfo &n, i32 seq, View &v) {
  const Model &m = b.m;
  const i64 row = b.row[0];
  int j = 0;
  if (n.flags & 1) v.times[0] = splat<VD>(seconds(m.t_start[row * m.step_columns + n.step_base + seq], m));
  for (const EdgeInfo *e = m.edge + n.first_edge; e < m.edge + n.first_edge + n.edges; e++) {
    const NodeInfo &s = m.node[e->sender];
    const i32 *messages = m.windows + row * m.window_columns + e->window_base + i64(seq) * e->window;
    for (i32 i = 0; i < e->window; i++, j++) {
      v.data[j] = b.moving + s.ring + (messages[i] & s.ring_mask) * s.count * s.size * W;
      if (!e->flags) continue;
      double sent, received;
      times_of(m, *e, row, messages[i], sent, received);
      v.seq[j] = splat<VL>(i64(messages[i]));
      v.times[1 + j] = splat<VD>(sent);
      v.times[1 + PLACES + j] = splat<VD>(received);
    }
  }
}

// Collect what node `n` sees at the steps `seq` of the lanes.
static void look(const Block &b, const NodeInfo &n, const i32 *seq, View &v) {
  if (b.uniform) return look_together(b, n, seq[0], v);
  const Model &m = b.m;
  char *stage = v.stage;
  int j = 0;
  if (n.flags & 1)
    for (int l = 0; l < W; l++)
      put(v.times[0], l, seconds(m.t_start[b.row[l] * m.step_columns + n.step_base + seq[l]], m));
  for (const EdgeInfo *e = m.edge + n.first_edge; e < m.edge + n.first_edge + n.edges; e++) {
    const NodeInfo &s = m.node[e->sender];
    const i64 bytes = s.count * s.size * W;
    const char *ring = b.moving + s.ring;
    for (i32 i = 0; i < e->window; i++, j++) {
      i32 message[W], cell[W];
      bool same = true;
      for (int l = 0; l < W; l++) {
        message[l] = m.windows[b.row[l] * m.window_columns + e->window_base + i64(seq[l]) * e->window + i];
        cell[l] = message[l] & s.ring_mask;
        same &= cell[l] == cell[0];
      }
      v.data[j] = ring + cell[0] * bytes;
      if (!same) {
        pick(ring, bytes, s.ring_mask, cell, s.count, s.size, stage);
        v.data[j] = stage;
        stage += bytes;
      }
      for (int l = 0; l < W && e->flags; l++) {
        double sent, received;
        times_of(m, *e, b.row[l], message[l], sent, received);
        put(v.seq[j], l, message[l]);
        put(v.times[1 + j], l, sent);
        put(v.times[1 + PLACES + j], l, received);
      }
    }
  }
}

// All lanes run step `seq` of a node: nothing is masked or copied.
static void run_together(Block &b, int index, i32 seq, const char *H, View &v) {
  const NodeInfo &n = b.m.node[index];
  char *state = b.moving + n.state;
  char *output = b.moving + n.ring + (seq & n.ring_mask) * n.count * n.size * W;
  look_together(b, n, seq, v);
  if (!(n.flags & 2)) {
    BODIES[index](b.fixed, H, state, v.data, v.seq, v.times, nullptr, state, output, b.m.constants);
    return;
  }
  char new_state[STATE * W];
  BODIES[index](b.fixed, H, state, v.data, v.seq, v.times, nullptr, new_state, output, b.m.constants);
  memcpy(state, new_state, (8 * n.n8 + 4 * n.n4 + n.n1) * W);
}

// Some lanes run steps `seq` of a node, the others (-1) keep what they had.
static void run_masked(Block &b, int index, const i32 *seq, const char *H, View &v) {
  const NodeInfo &n = b.m.node[index];
  const i64 bytes = n.count * n.size * W, state_bytes = (8 * n.n8 + 4 * n.n4 + n.n1) * W;
  char *state = b.moving + n.state, *ring = b.moving + n.ring;
  char new_state[STATE * W], output[OUTPUT * W];
  i32 runs[W], place[W];
  bool all = true, same = true;
  i32 some = 0;
  for (int l = 0; l < W; l++) some = seq[l] > some ? seq[l] : some;
  for (int l = 0; l < W; l++) {
    runs[l] = -(seq[l] >= 0);
    all &= seq[l] >= 0;
    same &= seq[l] == seq[0];
    place[l] = seq[l] >= 0 ? seq[l] : some; // the others look where these do; it is not used
  }
  look(b, n, place, v);
  const bool in_place = all && !(n.flags & 2);
  char *to_state = in_place ? state : new_state;
  char *to_output = all && same ? ring + (seq[0] & n.ring_mask) * bytes : output;
  BODIES[index](b.fixed, H, state, v.data, v.seq, v.times, nullptr, to_state, to_output, b.m.constants);
  if (!in_place && all) memcpy(state, new_state, state_bytes);
  else if (!all) {
    blend_sized(state, new_state, n.n8, 8, runs);
    blend_sized(state + 8 * n.n8 * W, new_state + 8 * n.n8 * W, n.n4, 4, runs);
    blend_bytes(state + (8 * n.n8 + 4 * n.n4) * W, new_state + (8 * n.n8 + 4 * n.n4) * W, n.n1, 1, runs);
  }
  if (to_output == output) write(b, n, seq, output);
}

// Everything before the supervisor step at which each lane is, then what the supervisor reads there.
static void run_slots(Block &b, const char *H, const char *action, View &v, bool observes) {
  const Model &m = b.m;
  for (i64 s = 0; s < m.slots; s++) {
    if (b.uniform) {
      const i32 seq = seq_at(m, b.row[0], b.step[0], s);
      if (seq >= 0) run_together(b, m.slot[s], seq, H, v);
      continue;
    }
    i32 seq[W];
    bool some = false;
    for (int l = 0; l < W; l++) {
      seq[l] = seq_at(m, b.row[l], b.step[l], s);
      some |= seq[l] >= 0;
    }
    if (some) run_masked(b, m.slot[s], seq, H, v);
  }
  if (!OBSERVES || !observes) return;
  const NodeInfo &n = m.node[m.supervisor];
  look(b, n, b.step, v);
  char new_state[STATE * W];
  char *state = b.moving + n.state;
  char *to = n.flags & 2 ? new_state : state;
  BODIES[m.supervisor](b.fixed, H, state, v.data, v.seq, v.times, action, to, b.moving + m.readings, m.constants);
  if (to != state) memcpy(state, new_state, (8 * n.n8 + 4 * n.n4 + n.n1) * W);
}

static Block open_block(const Model &m, const char *fixed, char *moving) {
  Block b{m, fixed, moving, {}, {}, true};
  memcpy(b.row, fixed + 4 * W, sizeof b.row);
  memcpy(b.step, moving, sizeof b.step);
  for (int l = 1; l < W; l++) b.uniform &= b.row[l] == b.row[0] && b.step[l] == b.step[0];
  return b;
}
static void gather(const i32 *environment, const char *from, i64 stride, i64 count, i64 size, char *to) {
  for (int l = 0; l < W; l++) {
    const char *own = from + (environment[l] < 0 ? environment[0] : environment[l]) * stride;
    for (i64 k = 0; k < count; k++) memcpy(to + (k * W + l) * size, own + k * size, size);
  }
}
template <int SIZE> static void scatter_as(const i32 *environment, const char *from, i64 count, char *to) {
  for (int l = 0; l < W; l++) {
    if (environment[l] < 0) continue;
    char *own = to + environment[l] * count * SIZE;
    for (i64 k = 0; k < count; k++) memcpy(own + k * SIZE, from + (k * W + l) * SIZE, SIZE);
  }
}
static void scatter(const i32 *environment, const char *from, i64 count, i64 size, char *to) {
  if (size == 4) scatter_as<4>(environment, from, count, to);
  else if (size == 8) scatter_as<8>(environment, from, count, to);
  else scatter_as<1>(environment, from, count, to);
}

// Returns the first environment that has fewer than `steps` steps left, or -1.
static i64 short_of_steps(const Model &m, const char *fixed, const char *moving, i64 first, i64 last, i64 steps) {
  i64 found = -1;
  for (i64 block = first; block < last; block++) {
    i32 step[W], environment[W];
    memcpy(step, moving + block * m.moving_bytes, sizeof step);
    memcpy(environment, fixed + block * m.fixed_bytes, sizeof environment);
    for (int l = 0; l < W; l++)
      if (environment[l] >= 0 && step[l] + steps > m.steps && (found < 0 || environment[l] < found))
        found = environment[l];
  }
  return found;
}

extern "C" i64 rollout(const Model *model, const char *fixed, const char *from, char *to, const Rollout *call) {
  const Model &m = *model;
  const Rollout &r = *call;
  const i64 spent = short_of_steps(m, fixed, from, r.first, r.last, r.steps);
  if (spent >= 0) return spent;
  const NodeInfo &n = m.node[m.supervisor];
  const i64 bytes = n.count * n.size;
  // Readings that nobody sees and that leave nothing behind are worked out at the last step only.
  const bool seen = r.policy || r.outputs || n.n8 || n.n4 || n.n1;
  View v;
  char H[HOISTED * W];
  char action[ACTION * W];
  char *G = (char *)__builtin_alloca(r.signal_bytes * W);
  for (i64 block = r.first; block < r.last; block++) {
    const char *own = fixed + block * m.fixed_bytes;
    char *moving = to + block * m.moving_bytes;
    if (to != from) memcpy(moving, from + block * m.moving_bytes, m.moving_bytes);
    i32 environment[W];
    memcpy(environment, own, sizeof environment);
    Block b = open_block(m, own, moving);
    prologue(own, H);
    for (i64 t = 0; t < r.steps; t++) {
      if (r.policy) {
        if (r.looks) look(b, n, b.step, v);
        for (i64 k = 0; k < r.signals; k++)
          gather(environment, r.signal_from[k] + t * r.signal_time[k], r.signal_environment[k], r.signal_count[k],
                 r.signal_size[k], G + r.signal_offset[k] * W);
        r.policy(r.weights, moving + m.readings, v.data, v.seq, v.times, G, action);
      } else
        gather(environment, r.actions + t * r.action_time, r.action_environment, n.count, n.size, action);
      if (r.out_actions) scatter(environment, action, n.count, n.size, r.out_actions + t * m.batch * bytes);
      write(b, n, b.step, action);
      for (int l = 0; l < W; l++) b.step[l]++;
      run_slots(b, H, action, v, seen || t == r.steps - 1);
      for (i64 k = 0; k < r.outputs; k++)
        scatter(environment, moving + m.readings + r.reading_offset[k] * W, r.reading_count[k], r.reading_size[k],
                r.out_readings[k] + t * m.batch * r.reading_count[k] * r.reading_size[k]);
    }
    memcpy(moving, b.step, sizeof b.step);
  }
  return -1;
}

extern "C" i64 step(const Model *m, const char *fixed, const char *from, char *to, const char *action) {
  const NodeInfo &n = m->node[m->supervisor];
  Rollout r{};
  r.steps = 1;
  r.last = m->blocks;
  r.actions = action;
  r.action_environment = n.count * n.size;
  return rollout(m, fixed, from, to, &r);
}

// Run up to the first step of the supervisor.
extern "C" void start(const Model *model, const char *fixed, char *moving) {
  const Model &m = *model;
  View v;
  char H[HOISTED * W];
  for (i64 block = 0; block < m.blocks; block++) {
    const char *own = fixed + block * m.fixed_bytes;
    Block b = open_block(m, own, moving + block * m.moving_bytes);
    prologue(own, H);
    run_slots(b, H, b.moving + m.node[m.supervisor].ring, v, true);
  }
}
