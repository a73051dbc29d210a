/* Loops over pairs of parts of a shell's faces.  What they are for says pairs.py, which calls them.

   Arrays are rows of doubles or of 64-bit integers.  A search writes no more than `capacity` pairs
   and counts on: with too little room it is called again with more. */

#include <math.h>
#include <stdint.h>
#include <string.h>

static double dot(const double* a, const double* b)
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void subtract(const double* a, const double* b, double* out)
{
  for (int i = 0; i < 3; ++i)
    out[i] = a[i] - b[i];
}

static double clamped(double x)
{
  return x > 1 ? 1 : x > 0 ? x : 0;
}

/* Twice the area of a triangle along its normal. */
static void area_vector(const double* a, const double* b, const double* c, double* out)
{
  double ab[3], ac[3];
  subtract(b, a, ab);
  subtract(c, a, ac);
  for (int i = 0; i < 3; ++i) {
    const int one = (i + 1) % 3, other = (i + 2) % 3;
    out[i] = ab[one] * ac[other] - ab[other] * ac[one];
  }
}

/* --- pieces: balls that go straight, and cones of normals -------------------------------------- */

enum { START = 0, END = 3, RADIUS = 6, AXIS = 7, COSINE = 10, SINE = 11, PIECE = 12 };

static void unify(double* vector)
{
  const double length = sqrt(dot(vector, vector));
  for (int i = 0; i < 3; ++i)
    vector[i] /= length > 0 ? length : 1;
}

/* The ball around the middle of corners, as large as they need: its squared radius. */
static double ball(int64_t n, const int64_t* corners, const double* x, double* centre)
{
  double square = 0;
  for (int i = 0; i < 3; ++i) {
    centre[i] = 0;
    for (int64_t k = 0; k < n; ++k)
      centre[i] += x[3 * corners[k] + i] / n;
  }
  for (int64_t k = 0; k < n; ++k) {
    double away[3];
    subtract(x + 3 * corners[k], centre, away);
    square = fmax(square, dot(away, away));
  }
  return square;
}

void balls(int64_t n_pieces, int64_t n, const int64_t* corners, const double* x, double bulge,
           double* out)
{
  for (int64_t k = 0; k < n_pieces; ++k)
    out[4 * k + 3] = bulge * sqrt(ball(n, corners + n * k, x, out + 4 * k));
}

void normals(int64_t n_triangles, const int64_t* triangles, int64_t n_vertices, const double* x,
             double* out)
{
  memset(out, 0, 3 * n_vertices * sizeof *out);
  for (int64_t k = 0; k < n_triangles; ++k) {
    const int64_t* corners = triangles + 3 * k;
    double normal[3];
    area_vector(x + 3 * corners[0], x + 3 * corners[1], x + 3 * corners[2], normal);
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i)
        out[3 * corners[j] + i] += normal[i];
  }
  for (int64_t k = 0; k < n_vertices; ++k)
    unify(out + 3 * k);
}

void pieces(int64_t n_pieces, int64_t n, const int64_t* corners, const double* start,
            const double* end, const double* normals_at_start, const double* normals_at_end,
            double bulge, double spread, double* out)
{
  for (int64_t k = 0; k < n_pieces; ++k, corners += n, out += PIECE) {
    const double* around[2] = {normals_at_start, normals_at_end};
    double cosine = 1, *axis = out + AXIS;
    out[RADIUS] = bulge * sqrt(fmax(ball(n, corners, start, out + START),
                                    ball(n, corners, end, out + END)));
    axis[0] = axis[1] = axis[2] = 0;
    for (int64_t j = 0; j < 2 * n; ++j)
      for (int i = 0; i < 3; ++i)
        axis[i] += around[j % 2][3 * corners[j / 2] + i];
    unify(axis);
    for (int64_t j = 0; j < 2 * n; ++j)
      cosine = fmin(cosine, dot(axis, around[j % 2] + 3 * corners[j / 2]));
    const double angle = fmin(spread * acos(fmax(cosine, -1)), acos(0));
    out[COSINE] = cos(angle);
    out[SINE] = sin(angle);
  }
}

/* Whether two pieces may look at each other and come nearer than the reach. */
static int meet(const double* a, const double* b, double reach)
{
  const double both = a[COSINE] * b[COSINE] - a[SINE] * b[SINE];
  const double bound = both > 0 ? a[SINE] * b[COSINE] + a[COSINE] * b[SINE] : 1.0;
  if (dot(a + AXIS, b + AXIS) >= bound)
    return 0;
  double from[3], to[3], way[3];
  subtract(a + START, b + START, from);
  subtract(a + END, b + END, to);
  subtract(to, from, way);
  const double square = dot(way, way);
  const double share = square > 0 ? clamped(-dot(from, way) / square) : 0.0;
  const double near = a[RADIUS] + b[RADIUS] + reach;
  double apart = 0;
  for (int i = 0; i < 3; ++i)
    apart += (from[i] + share * way[i]) * (from[i] + share * way[i]);
  return apart < near * near;
}

/* Whether two points, or the centres of two balls, are farther apart than a distance. */
static int apart_by(const double* a, const double* b, double distance)
{
  double apart[3];
  subtract(a, b, apart);
  return distance < 0 || dot(apart, apart) > distance * distance;
}

/* One more pair: written behind those before where there is room for it. */
static int64_t with_pair(int64_t i, int64_t j, int64_t count, int64_t capacity, int64_t* pairs)
{
  if (count < capacity) {
    pairs[2 * count] = i;
    pairs[2 * count + 1] = j;
  }
  return count + 1;
}

int64_t near_patches(int64_t n_cells, int64_t per_cell, const double* cells, const double* patches,
                     const double* rest, const int64_t* order, const double* low,
                     const double* high, double reach, double exempt, int64_t capacity,
                     int64_t* pairs)
{
  int64_t count = 0;
  for (int64_t one = 0; one < n_cells; ++one)
    for (int64_t other = one; other < n_cells; ++other) {
      const int64_t a = order[one], b = order[other];
      if (low[b] > high[a])
        break;
      if (!meet(cells + PIECE * a, cells + PIECE * b, reach))
        continue;
      for (int64_t i = a * per_cell; i < (a + 1) * per_cell; ++i) {
        if (a != b && !meet(patches + PIECE * i, cells + PIECE * b, reach))
          continue;
        for (int64_t j = a == b ? i + 1 : b * per_cell; j < (b + 1) * per_cell; ++j) {
          if (!meet(patches + PIECE * i, patches + PIECE * j, reach)
              || !apart_by(rest + 4 * i, rest + 4 * j, exempt - rest[4 * i + 3] - rest[4 * j + 3]))
            continue;
          count = with_pair(i, j, count, capacity, pairs);
        }
      }
    }
  return count;
}

/* --- points ------------------------------------------------------------------------------------ */

int64_t near_points(int64_t n_pairs, const int64_t* pairs, const int64_t* first, const double* x,
                    const double* rest, const double* balls, double reach, double exempt,
                    int64_t capacity, int64_t* found)
{
  int64_t count = 0;
  for (int64_t k = 0; k < n_pairs; ++k) {
    const int64_t a = pairs[2 * k], b = pairs[2 * k + 1];
    const double far = balls[4 * b + 3] + reach;
    for (int64_t i = first[a]; i < first[a + 1]; ++i) {
      double apart[3];
      subtract(x + 3 * i, balls + 4 * b, apart);
      if (dot(apart, apart) > far * far)
        continue;
      for (int64_t j = first[b]; j < first[b + 1]; ++j) {
        subtract(x + 3 * i, x + 3 * j, apart);
        if (dot(apart, apart) >= reach * reach)
          continue;
        if (!apart_by(rest + 3 * i, rest + 3 * j, exempt))
          continue;
        count = with_pair(i, j, count, capacity, found);
      }
    }
  }
  return count;
}

int64_t within(int64_t n_pairs, const int64_t* pairs, const double* x, double reach,
               int64_t* which, double* apart)
{
  int64_t count = 0;
  for (int64_t k = 0; k < n_pairs; ++k) {
    double* way = apart + 3 * count;
    subtract(x + 3 * pairs[2 * k], x + 3 * pairs[2 * k + 1], way);
    if (dot(way, way) < reach * reach)
      which[count++] = k;
  }
  return count;
}

/* Symmetric 3 x 3 matrices are the six components 11, 12, 13, 22, 23, 33. */
enum { SITES = 10, PARTS = 6, BLOCK = SITES * PARTS * SITES };

static void add_outer(const double* basis, const double* along, double factor, double* block)
{
  for (int a = 0; a < SITES; ++a)
    for (int k = 0; k < PARTS * SITES; ++k)
      block[a * PARTS * SITES + k] += factor * basis[a] * along[k];
}

void stiffness(int64_t n_pairs, const int64_t* pairs, const double* values,
               const int64_t* block_of_pair, int64_t n_points, const double* basis,
               const int64_t* block_of_point, double* own, double* blocks)
{
  double along[PARTS * SITES];
  for (int64_t k = 0; k < n_pairs;) {
    const int64_t i = pairs[2 * k], block = block_of_pair[k];
    memset(along, 0, sizeof along);
    for (; k < n_pairs && pairs[2 * k] == i && block_of_pair[k] == block; ++k) {
      const int64_t j = pairs[2 * k + 1];
      for (int c = 0; c < PARTS; ++c) {
        const double value = values[PARTS * k + c];
        own[PARTS * i + c] += value;
        own[PARTS * j + c] += value;
        for (int b = 0; b < SITES; ++b)
          along[c * SITES + b] += value * basis[SITES * j + b];
      }
    }
    add_outer(basis + SITES * i, along, -1.0, blocks + BLOCK * block);
  }
  for (int64_t i = 0; i < n_points; ++i) {
    if (block_of_point[i] < 0)
      continue;
    for (int c = 0; c < PARTS; ++c)
      for (int b = 0; b < SITES; ++b)
        along[c * SITES + b] = own[PARTS * i + c] * basis[SITES * i + b];
    add_outer(basis + SITES * i, along, 1.0, blocks + BLOCK * block_of_point[i]);
  }
}

/* --- triangles --------------------------------------------------------------------------------- */

typedef double triangle_t[3][3];

/* The vector from a point to the nearest one of a triangle (Ericson, Real-Time Collision
   Detection, 2005, section 5.1.5). */
static void from_point(const double* p, const triangle_t t, double* way)
{
  double ab[3], ac[3], ap[3];
  subtract(t[1], t[0], ab);
  subtract(t[2], t[0], ac);
  subtract(p, t[0], ap);
  const double aa = dot(ab, ab), bb = dot(ac, ac), c = dot(ab, ac);
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  const double d3 = d1 - aa, d4 = d2 - c, d5 = d1 - c, d6 = d2 - bb;
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  double v, w;
  if (d1 <= 0 && d2 <= 0)
    v = 0, w = 0;
  else if (d3 >= 0 && d4 <= d3)
    v = 1, w = 0;
  else if (d6 >= 0 && d5 <= d6)
    v = 0, w = 1;
  else if (vc <= 0 && d1 >= 0 && d3 <= 0)
    v = d1 / (d1 - d3), w = 0;
  else if (vb <= 0 && d2 >= 0 && d6 <= 0)
    v = 0, w = d2 / (d2 - d6);
  else if (va <= 0 && d4 >= d3 && d5 >= d6)
    w = (d4 - d3) / (d4 - d3 + d5 - d6), v = 1 - w;
  else
    v = vb / (va + vb + vc), w = vc / (va + vb + vc);
  for (int i = 0; i < 3; ++i)
    way[i] = v * ab[i] + w * ac[i] - ap[i];
}

/* The shortest vector from the edge p, q to the edge r, s (Ericson, section 5.1.9). */
static void between_edges(const double* p, const double* q, const double* r, const double* s,
                          double* way)
{
  double one[3], other[3], apart[3];
  subtract(q, p, one);
  subtract(s, r, other);
  subtract(p, r, apart);
  const double a = dot(one, one), e = dot(other, other), b = dot(one, other);
  const double c = dot(one, apart), f = dot(other, apart), square = a * e - b * b;
  double u = square > 1e-12 * a * e ? clamped((b * f - c * e) / square) : 0.0;
  double v = (b * u + f) / e;
  if (v < 0 || v > 1) {
    v = clamped(v);
    u = clamped((b * v - c) / a);
  }
  for (int i = 0; i < 3; ++i)
    way[i] = v * other[i] - apart[i] - u * one[i];
}

/* The distance of two triangles that do not cross, and the direction of the shortest way. */
static double distance(const triangle_t a, const triangle_t b, double* direction)
{
  double least = INFINITY, way[3];
  for (int k = 0; k < 15; ++k) {
    double sign = 1;
    if (k < 3)
      from_point(a[k], b, way);
    else if (k < 6) {
      from_point(b[k - 3], a, way);
      sign = -1;
    } else {
      const int i = (k - 6) / 3, j = (k - 6) % 3;
      between_edges(a[i], a[(i + 1) % 3], b[j], b[(j + 1) % 3], way);
    }
    const double square = dot(way, way);
    if (square < least) {
      least = square;
      for (int i = 0; i < 3; ++i)
        direction[i] = sign * way[i];
    }
  }
  least = sqrt(least);
  for (int i = 0; i < 3; ++i)
    direction[i] /= least > 0 ? least : 1;
  return least;
}

/* How far b lies beyond a along a direction: the distance is no less. */
static double beyond_along(const double* direction, const triangle_t a, const triangle_t b)
{
  double last = -INFINITY, first = INFINITY;
  for (int k = 0; k < 3; ++k) {
    last = fmax(last, dot(direction, a[k]));
    first = fmin(first, dot(direction, b[k]));
  }
  return first - last;
}

/* Whether the plane of a, or that of b, shows that they stay apart by a distance on straight ways:
   how far b lies beyond a along a direction is concave there. */
static int planes_part(const triangle_t a, const triangle_t b, const triangle_t a_last,
                       const triangle_t b_last, double distance)
{
  double normal[3], way[3];
  subtract(b[0], a[0], way);
  for (int k = 0; k < 2; ++k) {
    if (k == 0)
      area_vector(a[0], a[1], a[2], normal);
    else
      area_vector(b[0], b[1], b[2], normal);
    unify(normal);
    if (dot(normal, way) < 0)
      for (int i = 0; i < 3; ++i)
        normal[i] = -normal[i];
    const double now = beyond_along(normal, a, b); /* nought where there is no plane */
    if (now > 0 && now >= distance && beyond_along(normal, a_last, b_last) >= distance)
      return 1;
  }
  return 0;
}

static void place(const int64_t* corners, const double* start, const double* end, double share,
                  triangle_t out)
{
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) {
      const int64_t at = 3 * corners[k] + i;
      out[k][i] = (1 - share) * start[at] + share * end[at];
    }
}

/* Both triangles of a pair. */
static void place_both(const int64_t* pair, const int64_t* triangles, const double* start,
                       const double* end, double share, triangle_t a, triangle_t b)
{
  place(triangles + 3 * pair[0], start, end, share, a);
  place(triangles + 3 * pair[1], start, end, share, b);
}

/* Whether the balls of a pair are farther apart than a distance. */
static int balls_part(const int64_t* pair, const double* balls, double distance)
{
  const double *a = balls + 4 * pair[0], *b = balls + 4 * pair[1];
  return apart_by(a, b, a[3] + b[3] + distance);
}

void sagittas(int64_t n_triangles, const int64_t* triangles, const double* balls, const double* x,
              const double* normals, double spread, double* out)
{
  for (int64_t k = 0; k < n_triangles; ++k) {
    const int64_t* corners = triangles + 3 * k;
    double normal[3], cosine = 1;
    area_vector(x + 3 * corners[0], x + 3 * corners[1], x + 3 * corners[2], normal);
    unify(normal);
    for (int j = 0; j < 3; ++j)
      cosine = fmin(cosine, dot(normal, normals + 3 * corners[j]));
    const double angle = spread * acos(fmax(cosine, -1));
    out[k] = balls[4 * k + 3] * fmin(angle < acos(0) ? tan(angle) : 2, 2); /* a ball's diameter */
  }
}

int64_t near_curved(int64_t n_pairs, const int64_t* pairs, const int64_t* triangles,
                    const double* balls, const double* sagittas, const double* x, double reach,
                    int64_t* found)
{
  int64_t count = 0;
  for (int64_t k = 0; k < n_pairs; ++k) {
    const int64_t* pair = pairs + 2 * k;
    triangle_t a, b;
    if (balls_part(pair, balls, reach))
      continue;
    place_both(pair, triangles, x, x, 0, a, b);
    if (!planes_part(a, b, a, b, reach + sagittas[pair[0]] + sagittas[pair[1]]))
      count = with_pair(pair[0], pair[1], count, n_pairs, found);
  }
  return count;
}

double least_distance(int64_t n_pairs, const int64_t* pairs, const int64_t* triangles,
                      const double* balls, const double* x, double least)
{
  for (int64_t k = 0; k < n_pairs; ++k) {
    const int64_t* pair = pairs + 2 * k;
    triangle_t a, b;
    double direction[3];
    if (balls_part(pair, balls, least))
      continue;
    place_both(pair, triangles, x, x, 0, a, b);
    if (!planes_part(a, b, a, b, least))
      least = fmin(least, distance(a, b, direction));
  }
  return least;
}

enum { MOST_ADVANCES = 100 };
static const double LEAST_ADVANCE = 1e-3, LEFT = 1e-3;

double free_share(int64_t n_pairs, const int64_t* pairs, const int64_t* triangles,
                  const double* balls, const double* start, const double* end, double reach,
                  double apart)
{
  double limit = 1;
  for (int64_t k = 0; k < n_pairs; ++k) {
    const int64_t* pair = pairs + 2 * k;
    if (balls_part(pair, balls, reach))
      continue;
    triangle_t a, b, a_last, b_last;
    double share = 0, keep = apart;
    place_both(pair, triangles, start, end, limit, a_last, b_last);
    place_both(pair, triangles, start, end, share, a, b);
    if (planes_part(a, b, a_last, b_last, apart))
      continue;
    for (int n = 0;; ++n) {
      double direction[3];
      const double now = distance(a, b, direction);
      const double last = beyond_along(direction, a_last, b_last);
      if (n == 0) /* where they touch there is no direction */
        keep += LEFT * fmax(now - apart, 0);
      if (now >= keep && last >= keep)
        break;
      const double advance = now > keep ? (limit - share) * (now - keep) / (now - last) : 0;
      share += advance;
      if (advance < LEAST_ADVANCE * limit || n == MOST_ADVANCES) {
        limit = share;
        break;
      }
      place_both(pair, triangles, start, end, share, a, b);
    }
    if (limit <= 0)
      return 0;
  }
  return limit;
}
